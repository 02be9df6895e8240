"""How a keyframe moved: velocity and acceleration by the frames before and after it, or as it was tracked."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from helpers.flat_wall import at, insert, keyframe, wall_frames
from idfslam.frame import FPS, Status
from idfslam.sensing.rectification import Rectification, RowTimes
from idfslam.slam.keyframe_adjustment.keyframe_motion import KeyframeMotions, motion_through

TIMES = RowTimes(0.03, 0.025, 0.006)


def test_a_shaking_hand() -> None:
    """4 Hz, 2 rad/s: the spline has the turn's velocity to 1 % and its acceleration to 15 %; constant velocity is off by a fifth."""
    seconds, pulse = np.arange(-3, 4) / FPS, 2 * np.pi * 4
    angle = 2 / pulse * np.sin(pulse * seconds + 0.7) - 2 / pulse * np.sin(0.7)
    poses = np.tile(np.eye(4), (7, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(angle[:, None] * [0, 1.0, 0]).as_matrix()
    poses[:, :3, 3] = seconds[:, None] * [0.3, 0, 0.1] + seconds[:, None] ** 2 * [0.5, 0, 0]
    velocity, acceleration = motion_through(seconds, poses)
    assert velocity[4] == pytest.approx(2 * np.cos(0.7), rel=0.01)
    assert acceleration[4] == pytest.approx(-2 * pulse * np.sin(0.7), rel=0.15)
    assert (angle[3] - angle[2]) * FPS == pytest.approx(1.25 * 2 * np.cos(0.7), rel=0.05)
    np.testing.assert_allclose(velocity[:3], [0.3, 0, 0.1], atol=1e-9)
    np.testing.assert_allclose(acceleration[:3], [1.0, 0, 0], atol=1e-6)


def test_frames_around_a_keyframe_tell_its_motion_whatever_their_stamps_jitter() -> None:
    frames = wall_frames(places=(0.0,))
    for i in range(1, 9):
        new = keyframe(i, 0.02 * i)
        new.timestamp = i / FPS + 0.002 * (-1) ** i
        if i == 4:
            middle, new.rectification = new, Rectification(TIMES, np.ones(6))
        insert(frames, new)
    motion = KeyframeMotions(frames, lambda keyframe: TIMES).of(middle)
    np.testing.assert_allclose(motion.velocity, [0.02 * FPS, 0, 0, 0, 0, 0], rtol=0.15, atol=1e-6)
    np.testing.assert_allclose(motion.acceleration, np.zeros(6), atol=1e-6)
    assert motion.times is TIMES and motion.rectification is middle.rectification


def test_without_frames_around_it_moves_as_it_was_tracked() -> None:
    frames = wall_frames(places=(0.0,))
    first = frames.graph.keyframes[0]
    motions = KeyframeMotions(frames, lambda keyframe: RowTimes())
    assert motions.of(first).synchronised
    assert not motions.of(first).velocity.any()
    assert motions.of(first).covariance[3, 3] == pytest.approx(1.5**2)  # nothing is known
    first.velocity, first.velocity_covariance = np.full(6, 0.1), 0.01 * np.eye(6)
    assert motions.of(first).velocity is first.velocity
    assert motions.of(first).covariance[3, 3] == pytest.approx(0.01 + 0.05**2)
    assert not KeyframeMotions(frames, lambda keyframe: TIMES).of(first).synchronised


def test_frames_are_around_until_one_is_not_tracked() -> None:
    frames = wall_frames(places=(0.0,))
    for i, status in enumerate((Status.OK, Status.LOST, Status.OK, Status.OK, Status.DOUBTFUL)):
        frames.append((i + 1) / FPS, at(0.01 * i), status)
    stamps, poses = frames.around(keyframe(4, 0.03), 3)
    assert stamps.tolist() == [3 / FPS, 4 / FPS]
    torch.testing.assert_close(torch.from_numpy(poses[1]), at(0.03))
    for other in (keyframe(2, 0.01), keyframe(4, 0.02), keyframe(6, 0.0)):  # lost itself, of another run, none of the frames
        assert len(frames.around(other, 3)[0]) == 0
