"""Poses of frames hang on keyframes and move with them; before a wall."""

import numpy as np
import torch

from helpers.flat_wall import at, insert, keyframe, wall_frames
from idfslam.frame import Status
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


def test_frames_between_two_keyframes_follow_both() -> None:
    """Keyframes at 0 and 0.6 s, of which the first moves by 0.1 m: the middle one moves by half of that, the next one by 86 %."""
    frames = wall_frames(places=(0.0,))
    for i in range(1, 18):
        frames.append(i / 30, at(0.0), Status.OK)
    new = keyframe(18, 1.8)
    assert insert(frames, new)
    before = [k.T_wk.clone() for k in frames.graph.keyframes]
    frames.graph.keyframes[0].T_wk = at(0.1)
    frames.follow_around(before)
    moved = frames.trajectory()[:, 0, 3]
    np.testing.assert_allclose(moved[[0, 1, 9, 18]], [0.1, 0.0855, 0.05, 1.8], atol=1e-4)
    assert (np.diff(moved[1:18]) < 0).all()


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
