"""What a loop must show before it is believed, on keyframes in a row 0.5 m apart with edges from one to the next."""

import numpy as np
import pytest
import torch
from torch import Tensor

from idfslam.config import KeyframeConfig, LoopConfig
from idfslam.frame import Frame, Status
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.geometry.pose_distance import pose_distances
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.loop_consistency import Loop, LoopConsistency
from idfslam.graph.path_length import path_lengths

CAMERA = Camera(64, 48, 40.0, 40.0, 31.5, 23.5)
CONFIG = LoopConfig(slack=0.1, drift=0.03, confirmed_within=1.0)


def at(x: float, y: float = 0.0) -> Tensor:
    T = torch.eye(4, dtype=torch.float64)
    T[0, 3], T[1, 3] = x, y
    return T


@pytest.fixture
def frames() -> FramePoses:
    """Round a square of 5 m, back at the start with 0.2 m of drift in y; no keyframe sees what another sees."""
    graph = KeyframeGraph(KeyframeConfig(), verify=True)
    made = FramePoses(graph)
    for i in range(41):
        side, way = divmod(0.5 * i, 5)
        x, y = [(way, 0.0), (5.0, way), (5 - way, 5.0), (0.0, 5 - way), (0.0, 0.0)][int(side)]
        T_wk = at(x, y + 0.2 * i / 40)
        frame = Frame(i, i / 30, np.zeros((48, 64, 3), np.float32), np.full((48, 64), 0.05, np.float32), CAMERA)
        made.append(i / 30, T_wk, Status.OK)
        keyframe = Keyframe(frame, T_wk, torch.from_numpy(frame.depth), torch.from_numpy(frame.colour))
        assert graph.insert(keyframe)
        made.attach_last(keyframe)
    return made


@pytest.fixture
def graph(frames: FramePoses) -> KeyframeGraph:
    return frames.graph


def test_keyframes_have_edges_from_one_to_the_next(graph: KeyframeGraph) -> None:
    assert [sorted(k.edges) for k in graph.keyframes[:3]] == [[1], [0, 2], [1, 3]]
    np.testing.assert_allclose(path_lengths(graph.keyframes, 0)[[0, 1, 20, 40]], [0, 0.5, 10, 20], atol=0.11)


def test_a_turn_is_as_far_as_it_moves_what_is_ahead() -> None:
    """3 m of shift; a quarter turn about any axis: 2 m ahead, pi / 2 rad of it; a nearly half turn, where cosines are flat; none at all."""
    turns = [torch.zeros(3), torch.tensor([0, np.pi / 2, 0]), torch.tensor([3.1, 0, 0]), torch.tensor([0, 0, 1e-6])]
    T_b = se3.exp(torch.stack([torch.cat([torch.zeros(3), turn]) for turn in turns]).double())
    T_b[0, 0, 3] = 3.0
    np.testing.assert_allclose(pose_distances(np.eye(4)[None], T_b.numpy()), [3, np.pi, 6.2, 2e-6], rtol=1e-6)


def test_what_may_be_a_loop(graph: KeyframeGraph) -> None:
    """After 20 m 0.1 + 0.03 * 20 m of drift may be, and 1.5 m more lie between views of one place; short paths lead to the last ones."""
    assert graph.beyond(graph.keyframes[40], path_lengths(graph.keyframes, 40)) == list(range(32))
    assert LoopConsistency(CONFIG).within_reach(graph, graph.keyframes[40]) == [0, 1, 2, 3, 4]


def test_two_loops_that_agree_close(graph: KeyframeGraph, frames: FramePoses) -> None:
    loops = LoopConsistency(CONFIG)
    frames.append(2.0, graph.keyframes[40].T_wk @ at(0.01), Status.OK)
    assert loops.offer(graph, Loop(1, 39, at(-0.5, 0.5), 39)) == []
    assert loops.waiting is not None
    moved = loops.offer(graph, Loop(0, 40, at(0.0), 40))
    assert moved
    assert (len(loops.closed), loops.refused, loops.waiting) == (2, 0, None)
    assert moved[0] == 0
    assert moved[40] == pytest.approx(0.2, abs=0.02)
    np.testing.assert_allclose(graph.keyframes[40].T_wk, at(0.0), atol=0.01)
    np.testing.assert_allclose(frames.trajectory()[-1], graph.keyframes[40].T_wk @ at(0.01), atol=1e-12)  # frames follow
    assert 0 in graph.keyframes[40].edges and 40 in graph.keyframes[0].edges


def test_a_loop_alone_waits(graph: KeyframeGraph, frames: FramePoses) -> None:
    loops = LoopConsistency(CONFIG)
    before = frames.trajectory()
    assert loops.offer(graph, Loop(1, 39, at(-0.5, 0.5), 39)) == []
    assert loops.offer(graph, Loop(0, 40, at(0.3), 40)) == []  # asks for something else
    assert loops.closed == []
    np.testing.assert_array_equal(frames.trajectory(), before)


def test_more_than_drift_is_refused(graph: KeyframeGraph) -> None:
    loops = LoopConsistency(CONFIG)
    assert loops.offer(graph, Loop(2, 40, at(0.0), 40)) == []  # 1.02 m off after 19 m, where 0.67 m may be
    assert (loops.refused, loops.waiting) == (1, None)


def test_without_drift_keyframes_get_an_edge(graph: KeyframeGraph) -> None:
    loops = LoopConsistency(CONFIG)
    T_ab = se3.inverse(graph.keyframes[1].T_wk) @ graph.keyframes[39].T_wk
    assert loops.offer(graph, Loop(1, 39, T_ab, 39)) == []
    assert (loops.refused, loops.waiting) == (0, None)
    assert 1 in graph.keyframes[39].edges
