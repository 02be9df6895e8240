"""Poses of frames hang on keyframes and move with them; before a wall."""

import numpy as np
import torch

from helpers.flat_wall import at, insert, keyframe, wall_frames
from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.graph.frame_poses import FramePoses


def test_a_culled_frame_keeps_its_refined_pose() -> None:
    frames = wall_frames(places=(0.0,))
    frames.append(1.0, at(0.2), Status.OK)
    refined = keyframe(1, 0.25)
    assert not frames.graph.insert(refined)
    frames.attach_last(refined)
    torch.testing.assert_close(frames.T_wc(-1), at(0.25))


def test_frames_follow_their_keyframe() -> None:
    frames = wall_frames(places=(0.0,))
    frames.append(1.0, at(0.1), Status.LOST)
    frames.graph.keyframes[0].T_wk = at(0.5)
    np.testing.assert_allclose(frames.trajectory()[:, 0, 3], [0.5, 0.6])
    assert frames.statuses() == [Status.OK, Status.LOST]


def test_gaps_are_interpolated_by_time_and_can_be_undone() -> None:
    frames = wall_frames(places=(0.0,))
    for i in (1, 2):
        frames.append(i / 30, at(0.0), Status.LOST)
    frames.append(3 / 30, at(1.8), Status.OK)
    new = keyframe(3, 1.8)
    assert frames.graph.insert(new)
    frames.attach_last(new)
    assert frames.interpolate_gaps() == 2
    np.testing.assert_allclose(frames.trajectory()[:, 0, 3], [0, 0.6, 1.2, 1.8], atol=1e-12)
    assert frames.statuses() == [Status.OK, Status.INTERPOLATED, Status.INTERPOLATED, Status.OK]
    assert frames.interpolate_gaps() == 0
    frames.undo_interpolation_before(1)
    assert frames.statuses() == [Status.OK, Status.LOST, Status.LOST, Status.OK]


def test_the_latest_frames_are_moved_by_shares_back_to_the_last_keyframe_or_to_a_lost_frame() -> None:
    frames = wall_frames(places=(0.0,))
    for i in range(1, 4):
        frames.append(i / 30, at(0.1), Status.OK)
    frames.correct_latest(at(0.5), at(0.3), 0.5)
    np.testing.assert_allclose(frames.trajectory()[:, 0, 3], [0, 0.075, 0.05, 0], atol=1e-12)
    frames.append(4 / 30, at(0.0), Status.LOST)
    frames.append(5 / 30, at(0.1), Status.OK)
    frames.correct_latest(at(0.5), at(0.3), 0.5)
    np.testing.assert_allclose(frames.trajectory()[:, 0, 3], [0, 0.075, 0.05, 0, 0, 0], atol=1e-12)


def corrected_walk(statuses: dict[int, Status]) -> FramePoses:
    """Keyframes at 0 and 0.3 s, ten frames apart at 0.18 m each; the second is refined by 0.1 m when it is stored, and by 0.1 m later."""
    frames = wall_frames(places=(0.0,))
    for i in range(1, 11):
        frames.append(i / 30, at(0.18 * i), statuses.get(i, Status.OK))
    refined = keyframe(10, 1.9)
    assert frames.graph.insert(refined)
    frames.attach_last(refined)
    refined.T_wk = at(2.0)
    return frames


def test_a_correction_is_spread_over_the_frames_before_it() -> None:
    frames = corrected_walk({3: Status.DOUBTFUL})
    frames.spread_corrections()
    np.testing.assert_allclose(frames.trajectory()[:, 0, 3], 0.2 * np.arange(11), atol=1e-12)
    assert frames.in_host(5)[0] == 0
    frames.append(0.4, at(2.2), Status.OK)
    frames.spread_corrections()
    np.testing.assert_allclose(frames.trajectory()[-1, 0, 3], 2.2)  # no keyframe corrects it


def test_a_keyframe_that_was_drawn_away_alone_leaves_the_frames_before_it() -> None:
    """Something that moves drew its frame, but neither those before it nor the one after it, by 0.2 m."""
    frames = wall_frames(places=(0.0,))
    for i in range(1, 10):
        frames.append(i / 30, at(0.18 * i), Status.OK)
    frames.append(10 / 30, at(2.0), Status.OK)
    refined = keyframe(10, 1.8)
    assert frames.graph.insert(refined)
    frames.attach_last(refined)
    frames.append(11 / 30, at(1.98), Status.OK)
    frames.spread_corrections()
    np.testing.assert_allclose(frames.trajectory()[:, 0, 3], 0.18 * np.arange(12), atol=1e-3)


def test_a_turn_is_spread_without_a_shift() -> None:
    frames = corrected_walk({})
    turned = at(1.8)
    turned[:3, :3] = se3.exp(torch.tensor([0, 0, 0, 0, 0.1, 0], dtype=torch.float64))[:3, :3]
    frames.graph.keyframes[1].T_wk = turned
    frames.spread_corrections()
    np.testing.assert_allclose(frames.trajectory()[:, 0, 3], 0.18 * np.arange(11), atol=1e-12)
    np.testing.assert_allclose(se3.log(frames.T_wc(4))[4], 0.04, atol=1e-12)


def test_no_correction_is_spread_over_a_gap() -> None:
    frames = corrected_walk({4: Status.LOST})
    frames.spread_corrections()
    np.testing.assert_allclose(frames.trajectory()[:10, 0, 3], 0.18 * np.arange(10), atol=1e-12)


def test_how_far_a_submap_lies_apart_is_no_correction() -> None:
    frames = wall_frames(places=(0.0,))
    for i in (1, 2):
        frames.append(i / 30, at(0.18 * i), Status.DOUBTFUL)
    first = keyframe(3, 0.54)
    first.T_wk = frames.graph.start_submap()
    frames.append(0.1, first.T_wk, Status.OK)
    assert frames.graph.insert(first) and first.submap == 1
    frames.attach_last(first)
    first.T_wk, first.submap = at(0.54), 0  # merged
    frames.spread_corrections()
    np.testing.assert_allclose(frames.trajectory()[:, 0, 3], 0.18 * np.arange(4), atol=1e-12)


def test_state() -> None:
    frames = wall_frames(places=(0.0, 1.8))
    frames.append(1.0, at(1.9), Status.DEGENERATE)
    again = FramePoses(frames.graph)
    assert len(again) == 0
    assert again.trajectory().shape == (0, 4, 4)
    again.restore(frames.state())
    np.testing.assert_array_equal(again.trajectory(), frames.trajectory())
    assert again.statuses() == frames.statuses() == [Status.OK, Status.OK, Status.DEGENERATE]
    assert again.last_status is Status.DEGENERATE
    insert(again, keyframe(3, 3.6))
    assert len(again) == len(frames) + 1


def test_the_last_pose_and_whether_it_is_in_doubt() -> None:
    frames = FramePoses(wall_frames(places=(0.0,)).graph)
    assert not frames.in_doubt
    np.testing.assert_array_equal(frames.last_pose(at(0.3)), at(0.3))
    for status in (Status.OK, Status.LOST, Status.DEGENERATE, Status.DOUBTFUL):
        frames.append(0.0, at(0.1), status)
        assert frames.in_doubt is (status is Status.DOUBTFUL)
        np.testing.assert_allclose(frames.last_pose(at(0.3)), at(0.1), atol=1e-12)
