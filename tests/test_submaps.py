"""A camera that is lost in a place it does not know maps it in a submap of its own; submaps are merged where they meet."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from idfslam.config import FAST
from idfslam.datasets import Selection
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame, FrameResult, Status
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.submaps import merged_poses, separate_origin
from idfslam.slam import Slam
from idfslam.storage.state import State

CONFIG = replace(FAST, loops=replace(FAST.loops, submap_after=2))
FIRST, BACK = range(8), range(75, 1, -1)  # of the room's frames: a corner of it, and from the other side back to that corner
DARK = range(8, 11)
BEGUN = 12  # the second frame with depth for which it was looked for in vain
ORDER = [*FIRST, *(-1 for _ in DARK), *BACK]


@pytest.fixture(scope="module")
def room() -> Selection:
    return Selection(SyntheticRoom(seed=0, frames=240, width=320, height=240), frames=80, stride=3)


def frame(room: Selection, index: int, j: int) -> Frame:
    """Frame j of the room, or darkness for -1, as frame `index` of the run."""
    return replace(Frame.blank(0, 0.0, room.camera) if j < 0 else room[j], index=index, timestamp=index / 30, depth_timestamp=None)


def shown(room: Selection, slam: Slam, order: Sequence[int], first: int = 0) -> list[FrameResult]:
    return [slam.process(frame(room, i, j)) for i, j in enumerate(order, start=first)]


def restored(state: State, room: Selection) -> Slam:
    """Another Slam in that state of the walk, which a test may change."""
    again = Slam(CONFIG)
    again.restore(copy.deepcopy(state), lambda index: frame(room, index, ORDER[index]))
    return again


def truth(room: Selection, order: Sequence[int]) -> np.ndarray:
    """(N, 4, 4) in the camera of the first frame."""
    assert room.ground_truth is not None
    return (np.linalg.inv(room.ground_truth[0]) @ room.ground_truth)[order]


@dataclass(frozen=True)
class Walk:
    """The walk through the room, and what it was on the way; not to be changed."""

    slam: Slam
    results: list[FrameResult]
    state_at_30: State
    trajectory_at_60: np.ndarray
    figures_at_60: dict[str, float]


@pytest.fixture(scope="module")
def walked(room: Selection) -> Walk:
    slam = Slam(CONFIG)
    results = shown(room, slam, ORDER[:30])
    state = copy.deepcopy(slam.state())
    results += shown(room, slam, ORDER[30:60], 30)
    trajectory, figures = slam.trajectory(), slam.figures()
    results += shown(room, slam, ORDER[60:], 60)
    return Walk(slam, results, state, trajectory, figures)


@pytest.mark.slow
def test_submaps_are_merged_where_they_meet(walked: Walk, room: Selection) -> None:
    slam, results = walked.slam, walked.results
    assert slam.figures()["submaps_merged"] == 1
    assert slam.figures()["submaps"] == 1
    met = max(r.index for r in results if r.status is Status.LOST)
    lost = [r.index for r in results if r.status is Status.LOST]
    assert lost == list(range(DARK[0], met + 1))  # from the dark to the meeting, no longer
    assert met < len(ORDER) - 5
    known = [i for i in range(len(ORDER)) if i < DARK[0] or i >= BEGUN]
    off = np.linalg.norm(slam.trajectory()[:, :3, 3] - truth(room, ORDER)[:, :3, 3], axis=1)  # [m]
    assert max(off[keyframe.index] for keyframe in slam.graph.keyframes) < 0.015  # with seeds 0 to 2: 0.003 to 0.012
    assert np.median(off[known]) < 0.005
    assert off[known].max() < 0.02
    statuses = slam.statuses()
    assert all(statuses[i].measured for i in known)
    assert sum(statuses[i] is Status.DOUBTFUL for i in known) <= 8  # steps of 3.5 degrees a frame
    assert [i for i, status in enumerate(statuses) if status is Status.INTERPOLATED] == list(range(DARK[0], BEGUN))


@pytest.mark.slow
def test_the_map_follows(walked: Walk, room: Selection) -> None:
    """Surfaces of the second submap lie on the room's walls, in the first one's world."""
    slam = restored(walked.slam.state(), room)
    views = slam.coverage.views()
    assert len(views) > 10
    assert max(np.abs(view.T_wc[:3, 3]).max() for view in views) < 10
    keyframe = max(slam.graph.keyframes, key=lambda k: float(k.T_wk[:3, 3].norm()))  # of the second submap
    slam.finish()
    rows, columns = torch.meshgrid(torch.arange(20, 220, 20), torch.arange(20, 300, 20), indexing="ij")
    depth = keyframe.depth[rows, columns].flatten()
    points = keyframe.camera.backproject(keyframe.depth)[rows, columns].flatten(0, 1)[depth > 0]
    distance, _ = slam.front_end.aligner.query(se3.transform(keyframe.T_wk.float(), points))
    assert float(distance.abs().median()) < 0.01


@pytest.mark.slow
def test_meanwhile_the_reported_pose_is_the_last_one(walked: Walk) -> None:
    results = walked.results
    last, *apart = (r.T_wc for r in results if r.status is Status.LOST)
    assert np.linalg.norm((last - results[DARK[0] - 1].T_wc)[:3, 3]) < 0.05  # one step of the last motion
    for T_wc in apart:
        np.testing.assert_allclose(T_wc, last, atol=1e-9)


@pytest.mark.slow
def test_of_submaps_that_do_not_meet_the_largest_is_reported(room: Selection) -> None:
    slam = Slam(CONFIG)
    results = shown(room, slam, [*FIRST, -1, *range(75, 60, -1)])
    assert slam.figures()["submaps"] == 2
    assert [result.status for result in results[len(FIRST) :]] == [Status.LOST] * 16  # meanwhile it is not known where they are
    slam.finish()
    assert all(k.index > len(FIRST) for k in slam.graph.keyframes if k.submap == slam.graph.main_submap)
    statuses, path = slam.statuses(), slam.trajectory()[:, :3, 3]
    assert statuses[: len(FIRST)] == [Status.LOST] * len(FIRST) and all(status.measured for status in statuses[-10:])
    assert np.abs(path - path[-1]).max() < 3  # all of one world, 100 m from the other
    assert path[-1, 0] > 90
    assert np.abs(slam.mesh(0.05).vertices - path[-1]).max() < 10
    assert {k.submap for k in slam.stored_keyframes() if k.index > len(FIRST)} == {0}


@pytest.mark.slow
def test_without_submaps_it_stays_lost(room: Selection) -> None:
    slam = Slam(replace(CONFIG, loops=replace(CONFIG.loops, submap_after=0)))
    results = shown(room, slam, [*FIRST, -1, *range(75, 65, -1)])
    assert [r.status for r in results[len(FIRST) :]] == [Status.LOST] * 11
    assert all(k.index < len(FIRST) for k in slam.graph.keyframes)


@pytest.mark.slow
def test_a_run_that_goes_on_from_a_state_merges_alike(walked: Walk, room: Selection) -> None:
    """The state is one within the second submap."""
    again = restored(walked.state_at_30, room)
    shown(room, again, ORDER[30:60], 30)
    np.testing.assert_array_equal(again.trajectory(), walked.trajectory_at_60)
    assert again.figures() == walked.figures_at_60


def keyframe(x: float, submap: int, host: int) -> Keyframe:
    camera = Camera(4, 4, 4.0, 4.0, 1.5, 1.5)
    frame = Frame.blank(host, 0.0, camera)
    T_wk = se3.exp(torch.tensor([0, 0, 0, 0.1 * host, 0.2, 0], dtype=torch.float64))
    T_wk[0, 3] = x
    made = Keyframe(frame, T_wk, torch.from_numpy(frame.depth), torch.from_numpy(frame.colour))
    made.submap, made.host = submap, host
    return made


def test_a_submap_begins_far_from_all_others() -> None:
    T = separate_origin([keyframe(0.0, 0, 0), keyframe(130.0, 1, 1), keyframe(30.0, 0, 2)])
    assert T[:3, 3].tolist() == [230.0, 0.0, 0.0]


@pytest.mark.parametrize(("a", "b"), [(0, 2), (2, 0), (1, 3), (3, 1)])
def test_the_younger_submap_is_moved_to_the_older(a: int, b: int) -> None:
    keyframes = [keyframe(0.0, 0, 0), keyframe(1.0, 0, 1), keyframe(100.0, 2, 2), keyframe(101.0, 2, 3)]
    T_ab = se3.exp(torch.tensor([0.3, -0.2, 0.1, 0.2, 0.4, -0.1], dtype=torch.float64))
    poses = merged_poses(keyframes, a, b, T_ab)
    torch.testing.assert_close(se3.inverse(poses[a]) @ poses[b], T_ab)
    for i in (0, 1):
        assert torch.equal(poses[i], keyframes[i].T_wk)
    inside = se3.inverse(keyframes[2].T_wk) @ keyframes[3].T_wk
    torch.testing.assert_close(se3.inverse(poses[2]) @ poses[3], inside)


def test_a_recording_that_begins_outside_the_map_it_starts_in() -> None:
    graph = KeyframeGraph(FAST.keyframes, verify=True)
    frames = FramePoses(graph)
    graph.load(keyframe(0.0, 0, 0))
    T_wc = graph.start_submap()
    new = keyframe(float(T_wc[0, 3]), 0, 0)
    frames.append(0.0, new.T_wk, Status.OK)
    assert graph.insert(new)
    frames.attach_last(new)
    assert [k.submap for k in graph.keyframes] == [0, 1]
    assert graph.main_submap == 0
    np.testing.assert_array_equal(frames.trajectory(), np.eye(4)[None])
    assert frames.statuses() == [Status.LOST]
    T_01 = se3.exp(torch.tensor([1.0, 0, 0, 0, 0, 0], dtype=torch.float64))
    moved = graph.merge_submaps(0, 1, T_01)
    assert moved[0] == 0
    assert moved[1] > 90
    assert frames.statuses() == [Status.OK]
    torch.testing.assert_close(torch.from_numpy(frames.trajectory()[0]), graph.keyframes[0].T_wk @ T_01)
    assert graph.keyframes[1].edges == {0}


def test_at_the_end_the_submap_with_the_most_keyframes_is_reported() -> None:
    """A camera that is lost after one keyframe and maps on elsewhere: what it maps later counts."""
    graph = KeyframeGraph(FAST.keyframes)
    frames = FramePoses(graph)
    graph.choose_main_submap()  # without any keyframe nothing happens
    chosen = []
    for i, submap in enumerate([0, 1, 1, 1]):
        graph.last_keyframe = keyframe(100.0 * (i > 0) + i, submap, i)
        graph.keyframes.append(graph.last_keyframe)
        frames.append(i / 30, graph.last_keyframe.T_wk, Status.OK)
        assert frames.statuses() == ([Status.OK, *[Status.LOST] * 3])[: i + 1]
        graph.choose_main_submap()
        chosen.append(graph.main_submap)
        graph.main_submap = 0
    assert chosen == [0, 0, 1, 1]  # of two that are as large, the first
    graph.choose_main_submap()
    assert frames.statuses() == [Status.LOST, Status.OK, Status.OK, Status.OK]
    np.testing.assert_allclose(frames.trajectory()[:, 0, 3], [101.0, 101.0, 102.0, 103.0])
