"""Registration of a new keyframe with the last one, and what is remembered of it. A bare wall leaves three directions open."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from test_alignment import CONFIG, CORNER, EYE, WALL, aligner, error, pose, taught, view
from torch import Tensor

from idfslam.bundle_adjustment import BundleAdjustment
from idfslam.config import FAST
from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframes import KeyframeGraph
from idfslam.mapping.mapper import Mapper

UNCULLED = replace(FAST.keyframes, culling=False)
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


@pytest.fixture(scope="module")
def corner() -> Mapper:
    return taught(CORNER)


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
    adjustment(graph, wall, Registration(SLID)).register(keyframe)
    assert error(keyframe.T_wk, SLID)[0] < 0.005
    assert keyframe.registered is not None
    assert keyframe.registered[0] == 0
    np.testing.assert_allclose(keyframe.registered[1], SLID, atol=1e-12)


@pytest.mark.parametrize("localiser", [Registration(None), Registration(SLID, agreed=False)])
def test_lost_or_contradicted_by_the_images_it_counts_for_nothing(graph: KeyframeGraph, wall: Mapper, localiser: Registration) -> None:
    keyframe = view(WALL, EYE, index=1, paint=0.0)
    adjustment(graph, wall, localiser).register(keyframe)
    assert keyframe.registered is None
    assert torch.equal(keyframe.T_wk, EYE)


def test_refinement_holds_to_it_too(corner: Mapper) -> None:
    """In a corner depth has a say in every direction, and the pose ends between the two."""
    refined = []
    for registered in (None, (0, pose(0.015, 0, 0, 0, 0, 0))):
        made, keyframe = KeyframeGraph(UNCULLED, torch.Generator().manual_seed(0)), view(CORNER, EYE, index=1, paint=0.0)
        for stored in (view(CORNER, EYE, paint=0.0), keyframe):
            made.append(0.0, EYE, Status.OK)
            made.promote(stored)
        keyframe.registered = registered
        refinement = adjustment(made, corner, Registration(None))
        for _ in range(5):
            refinement.refine([keyframe])
        refined.append(float(keyframe.T_wk[0, 3]))
    assert refined[0] == pytest.approx(0, abs=0.002)
    assert 0.003 < refined[1] < 0.012


def test_it_is_part_of_the_state() -> None:
    keyframe, again = view(WALL, EYE, index=1), view(WALL, EYE, index=1)
    keyframe.registered = 3, SLID
    again.restore(keyframe.state())
    assert again.registered is not None
    assert again.registered[0] == 3
    assert torch.equal(again.registered[1], SLID)
