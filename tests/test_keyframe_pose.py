"""Registration of a new keyframe with the last one. A bare wall leaves three directions open."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from helpers.three_walls import CONFIG, EYE, WALL, aligner, error, pose, taught, view
from idfslam.config import FAST
from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.mapping.mapper import Mapper
from idfslam.slam.back_end.keyframe_pose import KeyframeRegistration
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Evidence, Source, Tracked

UNCULLED = replace(FAST.keyframes, cull=1.0)
SLID = pose(0.03, -0.02, 0, 0, 0, 0)


class Registration:
    """A relocaliser whose tracker has a given answer."""

    references = 2

    def __init__(self, T_wc: Tensor | None, *, agreed: bool = True) -> None:
        self.T_wc, self.agreed = T_wc, agreed

    def registered(self, view: Keyframe, keyframe: Keyframe, near: Tensor | None = None) -> Tensor | None:
        return self.T_wc

    def images_agree(self, view: Keyframe, keyframe: Keyframe, T_wc: Tensor) -> bool:
        return self.agreed


@pytest.fixture(scope="module")
def wall() -> Mapper:
    return taught(WALL)


@pytest.fixture
def graph() -> KeyframeGraph:
    """One keyframe, without anything in its image to hold on to."""
    made = KeyframeGraph(UNCULLED, verify=True)
    made.insert(view(WALL, EYE, paint=0.0))
    return made


def registration(graph: KeyframeGraph, learner: Mapper, relocaliser: Registration) -> KeyframeRegistration:
    return KeyframeRegistration(CONFIG, relocaliser, aligner(learner), graph, StageTimer())  # type: ignore[arg-type]


def tracked(least_information: float = 0.0, source: Source = Source.ALIGNED) -> Tracked:
    return Tracked(EYE, Status.OK, source, Evidence(least_information=least_information))


def test_a_keyframe_is_held_to_its_registration(graph: KeyframeGraph, wall: Mapper) -> None:
    keyframe, step = view(WALL, EYE, index=1, paint=0.0), registration(graph, wall, Registration(SLID))
    assert step.refine(keyframe, tracked()) == {}
    assert error(keyframe.T_wk, SLID)[0] < 0.005
    assert list(step.timer.milliseconds) == ["register"]


@pytest.mark.parametrize("relocaliser", [Registration(None), Registration(SLID, agreed=False)])
def test_lost_or_contradicted_by_the_images_it_counts_for_nothing(graph: KeyframeGraph, wall: Mapper, relocaliser: Registration) -> None:
    keyframe = view(WALL, EYE, index=1, paint=0.0)
    registration(graph, wall, relocaliser).refine(keyframe, tracked())
    assert torch.equal(keyframe.T_wk, EYE)


@pytest.mark.parametrize(("information", "asked"), [(0.19, True), (0.21, False)])
def test_the_tracker_is_asked_only_where_it_can_add_something(graph: KeyframeGraph, wall: Mapper, information: float, asked: bool) -> None:
    # Twice `registration_prior_information`, 0.1: from there on a pose follows its registration by less than a sixteenth of the way.
    keyframe = view(WALL, EYE, index=1, paint=0.0)
    registration(graph, wall, Registration(SLID)).refine(keyframe, tracked(information))
    assert (error(keyframe.T_wk, SLID)[0] < 0.005) is asked


def test_a_pose_that_the_tracker_gave_against_the_map_is_kept(graph: KeyframeGraph, wall: Mapper) -> None:
    keyframe = view(WALL, EYE, index=1, paint=0.0)
    registration(graph, wall, Registration(SLID)).refine(keyframe, tracked(source=Source.REGISTERED))
    assert torch.equal(keyframe.T_wk, EYE)


@pytest.mark.parametrize(("better", "used"), [(1.02, True), (1.1, False)])
def test_a_registration_that_fits_worse_than_the_tracked_pose_counts_for_nothing(
    graph: KeyframeGraph, wall: Mapper, better: float, used: bool
) -> None:
    """Both poses fit the wall equally well. The tracked one is said to fit by this factor better; 1 / 0.95 is the limit."""
    keyframe = view(WALL, EYE, index=1, paint=0.0)
    found = aligner(wall).align(keyframe, SLID, graph.references(2), registered=True)
    alignment = replace(found, overlap=better * found.overlap)
    assert alignment.score == pytest.approx(better * found.score)
    registration(graph, wall, Registration(SLID)).refine(keyframe, replace(tracked(), alignment=alignment))
    assert (error(keyframe.T_wk, SLID)[0] < 0.005) is used
