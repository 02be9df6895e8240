"""Refinement of stored keyframes in turns with the map, and the polish at the end of a run."""

from dataclasses import replace

import pytest
import torch

from helpers.three_walls import CORNER, EYE, aligner, error, pose, taught, view
from idfslam.config import FAST
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.replay import Replay
from idfslam.mapping.mapper import Mapper
from idfslam.slam.back_end.polish import NoPolish, Polish
from idfslam.slam.back_end.refinement import KeyframeRefinement, NoRefinement, Refinement
from idfslam.slam.back_end.relearn_queue import RelearnQueue
from idfslam.slam.keyframe_adjustment.global_adjustment import NoAdjustment

OFF = pose(0.01, 0, 0, 0, 0, 0)


@pytest.fixture(scope="module")
def corner() -> Mapper:
    return taught(CORNER)


@pytest.fixture
def graph() -> KeyframeGraph:
    """Two keyframes of a corner, the second of which is 1 cm off."""
    made = KeyframeGraph(replace(FAST.keyframes, cull=1.0), verify=True)
    for i in range(2):
        made.insert(view(CORNER, EYE, index=i))
    made.set_pose(made.keyframes[1], OFF)
    return made


def refinement(graph: KeyframeGraph, queue: RelearnQueue, learner: Mapper) -> KeyframeRefinement:
    return KeyframeRefinement(FAST.refinement, graph, queue, aligner(learner), references=FAST.alignment.references)


def test_where_a_loop_has_put_a_keyframe_it_stays_until_the_map_has_followed(graph: KeyframeGraph, corner: Mapper) -> None:
    queue, moved = RelearnQueue(2), graph.keyframes[1]
    refiner = refinement(graph, queue, corner)
    queue.add([moved])
    refiner.refine([moved])
    assert error(moved.T_wk, EYE)[0] == pytest.approx(0.01)
    for _ in range(2):
        queue.trained([moved])
    assert moved not in queue
    refiner.refine([moved])
    assert error(moved.T_wk, EYE)[0] == pytest.approx(0.005, abs=0.001)  # half way to where the map, which has learnt nothing, has it


def test_the_first_keyframe_of_a_submap_is_its_world(graph: KeyframeGraph, corner: Mapper) -> None:
    first = graph.keyframes[0]
    graph.set_pose(first, OFF)
    refinement(graph, RelearnQueue(2), corner).refine([first])
    assert torch.equal(first.T_wk, OFF)


class Counted(Refinement):
    """Counts what it is asked to refine."""

    def __init__(self) -> None:
        self.counts: list[int] = []

    def refine(self, keyframes: object) -> None:
        self.counts.append(len(keyframes))  # type: ignore[arg-type]


class Steps:
    """A map that notes its updates."""

    def __init__(self) -> None:
        self.updates: list[tuple[int, int, float, float]] = []
        self.finished = False

    def start_update(self, frames: list[object], iterations: int, *, anneal: float, cores: float) -> dict[str, float]:
        self.updates.append((len(frames), iterations, anneal, cores))
        return {}

    def finish(self) -> dict[str, float]:
        self.finished = True
        return {}


def polished(graph: KeyframeGraph, seconds: float) -> tuple[Counted, Steps]:
    """By four updates on two keyframes, of which one is refined; each takes three steps."""
    config = replace(FAST.refinement, keyframes=2, updates=4, rounds=0.0, seconds=seconds)
    refiner, steps = Counted(), Steps()
    replay = Replay(FAST.keyframes, graph, torch.Generator().manual_seed(0))
    Polish(config, 3, graph, replay, RelearnQueue(2), NoAdjustment(), refiner, steps).run()  # type: ignore[arg-type]
    return refiner, steps


def test_the_polish_shrinks_its_steps_to_nothing(graph: KeyframeGraph) -> None:
    refiner, steps = polished(graph, 1000.0)
    assert refiner.counts == [1] * 4
    assert steps.updates == [(2, 3, 1.0, 1.0), (2, 3, 0.75, 1.0), (2, 3, 0.5, 1.0), (2, 3, 0.25, 1.0)]  # with all cores
    assert steps.finished


def test_where_time_has_run_out_the_polish_ends(graph: KeyframeGraph) -> None:
    _, steps = polished(graph, 1e-9)
    assert steps.updates == []
    assert steps.finished


def test_without_them_nothing_moves(graph: KeyframeGraph) -> None:
    NoRefinement().refine(graph.keyframes)
    NoPolish().run()
    assert torch.equal(graph.keyframes[1].T_wk, OFF)


class Adjusted(NoAdjustment):
    """Keyframes whose poses are final."""

    def run(self) -> bool:
        return True


def test_adjusted_keyframes_are_not_refined_one_at_a_time(graph: KeyframeGraph) -> None:
    refiner, steps = Counted(), Steps()
    replay = Replay(FAST.keyframes, graph, torch.Generator().manual_seed(0))
    Polish(FAST.refinement, 3, graph, replay, RelearnQueue(2), Adjusted(), refiner, steps).run()  # type: ignore[arg-type]
    assert refiner.counts == []
    assert len(steps.updates) == FAST.refinement.updates
