"""Registration of a new keyframe with the last one. A bare wall leaves three directions open."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from helpers.three_walls import CONFIG, CORNER, EYE, WALL, aligner, error, pose, taught, view
from idfslam.config import FAST
from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.mapping.mapper import Mapper
from idfslam.slam.refinement import BundleAdjustment

UNCULLED = replace(FAST.keyframes, cull=1.0)
SLID = pose(0.03, -0.02, 0, 0, 0, 0)


class Registration:
    """A localiser whose tracker answers what it is told to."""

    references = 2

    def __init__(self, T_wc: Tensor | None, *, agreed: bool = True) -> None:
        self.T_wc, self.agreed = T_wc, agreed

    def registered(self, view: Keyframe, keyframe: Keyframe) -> Tensor | None:
        return self.T_wc

    def agrees(self, view: Keyframe, keyframe: Keyframe, T_wc: Tensor) -> bool:
        return self.agreed


@pytest.fixture(scope="module")
def wall() -> Mapper:
    return taught(WALL)


@pytest.fixture
def graph() -> KeyframeGraph:
    """One keyframe, without anything in its image to hold on to."""
    made = KeyframeGraph(UNCULLED, torch.Generator().manual_seed(0), verify=True)
    made.append(0.0, EYE, Status.OK)
    made.promote(view(WALL, EYE, paint=0.0))
    return made


def adjustment(graph: KeyframeGraph, learner: Mapper, localiser: Any) -> BundleAdjustment:
    return BundleAdjustment(replace(FAST, alignment=CONFIG), graph, learner, aligner(learner), localiser)


def test_a_keyframe_is_held_to_its_registration(graph: KeyframeGraph, wall: Mapper) -> None:
    keyframe = view(WALL, EYE, index=1, paint=0.0)
    adjustment(graph, wall, Registration(SLID)).register(keyframe, 0.0)
    assert error(keyframe.T_wk, SLID)[0] < 0.005


@pytest.mark.parametrize("localiser", [Registration(None), Registration(SLID, agreed=False)])
def test_lost_or_contradicted_by_the_images_it_counts_for_nothing(graph: KeyframeGraph, wall: Mapper, localiser: Registration) -> None:
    keyframe = view(WALL, EYE, index=1, paint=0.0)
    adjustment(graph, wall, localiser).register(keyframe, 0.0)
    assert torch.equal(keyframe.T_wk, EYE)


@pytest.mark.parametrize(("known", "asked"), [(0.19, True), (0.21, False)])
def test_the_tracker_is_asked_only_where_it_can_add_something(graph: KeyframeGraph, wall: Mapper, known: float, asked: bool) -> None:
    # Twice `registration_prior_information`, 0.1: from there on a pose follows its registration by less than a sixteenth of the way.
    keyframe = view(WALL, EYE, index=1, paint=0.0)
    adjustment(graph, wall, Registration(SLID)).register(keyframe, known)
    assert (error(keyframe.T_wk, SLID)[0] < 0.005) is asked


def test_where_a_loop_has_put_a_keyframe_it_stays_until_the_map_has_followed() -> None:
    learner, made = taught(CORNER), KeyframeGraph(UNCULLED, torch.Generator().manual_seed(0), verify=True)
    for i in range(2):
        made.append(0.1 * i, EYE, Status.OK)
        made.promote(view(CORNER, EYE, index=i))
    moved, refiner = made.keyframes[1], adjustment(made, learner, Registration(None))
    moved.T_wk, moved.unlearnt = pose(0.01, 0, 0, 0, 0, 0), 2
    refiner.refine([moved])
    assert error(moved.T_wk, EYE)[0] == pytest.approx(0.01)
    for _ in range(2):
        learner.optimise_map([moved], 0)
    assert moved.unlearnt == 0
    refiner.refine([moved])
    assert error(moved.T_wk, EYE)[0] == pytest.approx(0.005, abs=0.001)  # half way to where the map, which has learnt nothing, has it
