"""Smoothing of frames' poses by the frames after them, on a straight line before a wall."""

import numpy as np
import torch

from helpers.flat_wall import at, wall_frames
from idfslam.alignment.acceleration_noise import Passage
from idfslam.alignment.continuous_motion import Filtered
from idfslam.alignment.motion_smoother import MotionSmoother
from idfslam.frame import Status
from idfslam.graph.frame_poses import FramePoses

DT = 0.1  # [s]
SPEED = 0.3  # [m/s] along x


def walk(places: list[float], *, speed: float, speed_error: float, correlation: float) -> tuple[FramePoses, MotionSmoother]:
    """Frames at x = places [m], of which the first is a keyframe. Each has this speed [m/s], and a standard deviation of 1 cm in its place.

    speed_error [m/s], correlation: of place and speed, as the filter has them.
    """
    frames, smoother = wall_frames(places=(places[0],)), MotionSmoother()
    covariance = np.diag([1e-4] * 6 + [speed_error**2] * 6)
    covariance[0, 6] = covariance[6, 0] = correlation * 1e-2 * speed_error
    for i, x in enumerate(places):
        if i:
            frames.append(i * DT, at(x), Status.OK)
        passage = Passage(DT, np.array([1e-3, 1e-3])) if i else None
        smoother.add(i, Filtered(np.eye(3), np.array([speed, 0, 0, 0, 0, 0]), covariance, passage))
    return frames, smoother


def test_a_frame_off_a_steady_walk_is_drawn_to_it() -> None:
    """By hand: the next frame, with the same speed, lies 1 cm behind where this one's leads. The gain takes P / (P + Q / 4) of that.

    Q is the variance that the acceleration adds to the place, of which a quarter is left where the speed did not change.
    """
    places = [0.0, 0.04, 0.06]
    frames, smoother = walk(places, speed=SPEED, speed_error=1e-6, correlation=0.0)
    smoother.smooth(frames)
    gain = 1e-4 / (1e-4 + 1e-6 / 4)
    np.testing.assert_allclose(frames.trajectory()[:, 0, 3], [0, 0.04 - 0.01 * gain, 0.06], atol=1e-7)


def test_a_wrong_speed_that_bent_the_pose_is_found_by_the_next_frame() -> None:
    """Against the formula of Rauch, Tung and Striebel. The pose is less than 1 cm off, and the speed by 0.1 m/s, which bent it."""
    frames, smoother = walk([0.0, 0.04, 0.06], speed=SPEED, speed_error=0.2, correlation=0.9)
    smoother.smooth(frames)
    passage = Passage(DT, np.array([1e-3, 1e-3]))
    F, P = passage.transition, np.diag([1e-4] * 6 + [0.04] * 6)
    P[0, 6] = P[6, 0] = 0.9 * 1e-2 * 0.2
    G = P @ F.T @ np.linalg.inv(F @ P @ F.T + passage.noise)
    expected = 0.04 + G[0, 0] * (0.02 - DT * SPEED)
    np.testing.assert_allclose(frames.trajectory()[1, 0, 3], expected, atol=1e-9)
    assert 0.03 < expected < 0.04


def test_a_keyframe_stays_and_a_gap_is_not_crossed() -> None:
    frames, smoother = walk([0.0, 0.04, 0.06], speed=SPEED, speed_error=0.2, correlation=0.0)
    before = frames.trajectory()
    smoother.add(2, Filtered(np.eye(3), np.array([SPEED, 0, 0, 0, 0, 0]), np.eye(12), None))
    smoother.smooth(frames)
    np.testing.assert_array_equal(frames.trajectory()[[0, 2]], before[[0, 2]])
    np.testing.assert_allclose(frames.trajectory()[1], before[1], atol=1e-12)


def test_the_world_may_have_turned_since() -> None:
    """Turned by 90 degrees about y, a walk along x goes along -z, and is smoothed alike."""
    frames, smoother = walk([0.0, 0.04, 0.06], speed=SPEED, speed_error=1e-6, correlation=0.0)
    frames.graph.keyframes[0].T_wk = at(0.0, turn=90.0)
    smoother.smooth(frames)
    np.testing.assert_allclose(frames.trajectory()[1, :3, 3], [0, 0, -(0.04 - 0.01 / 1.0025)], atol=1e-7)


def test_state() -> None:
    frames, smoother = walk([0.0, 0.04, 0.06], speed=SPEED, speed_error=0.2, correlation=0.5)
    again = MotionSmoother()
    again.restore(smoother.state())
    other = FramePoses(frames.graph)
    other.restore(frames.state())
    smoother.smooth(frames)
    again.smooth(other)
    np.testing.assert_array_equal(other.trajectory(), frames.trajectory())
    empty = MotionSmoother()
    empty.restore(MotionSmoother().state())
    empty.smooth(frames)
    assert torch.equal(torch.from_numpy(other.trajectory()), torch.from_numpy(frames.trajectory()))
