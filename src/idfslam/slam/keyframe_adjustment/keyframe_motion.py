"""How the camera moved while it took a keyframe, by the poses of the frames before and after it.

The velocity that is estimated with a pose knows only what came before, and lags behind in a shaking hand. The frames after it tell more,
and the acceleration too: within the rows of an image a hand that shakes at 5 Hz does not have a constant velocity.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from idfslam.adjustment.row_motion import KeyframeMotion
from idfslam.alignment.continuous_motion import HAND_SPEED
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.sensing.rectification import RowTimes

Array = NDArray[np.float64]

_REACH = 3  # frames before and after a keyframe that tell of its motion. More: less noise, and fast shaking is smoothed away
STAMPS = 15  # frames before and after, whose stamps give the usual interval: stamps jitter. More: changes are followed more slowly
_LEAST = 5  # frames in all. More: keyframes beside lost frames keep the velocity that they were tracked with
_SLOWEST = 0.05  # [s] longest usual interval of frames that tell of a shaking hand. More: velocities are smoothed more
# [m/s], [rad/s] Standard deviation of a velocity by the frames around. More: what bends an image otherwise, such as blur, passes for
# velocity.
_ERROR = 0.03, 0.05


class KeyframeMotions:
    """Of the stored keyframes of a run."""

    def __init__(self, frames: FramePoses, times: Callable[[Keyframe], RowTimes]) -> None:
        """times: of the rows of a keyframe's images as they were taken, as far as they are known."""
        self.frames, self.times = frames, times

    def of(self, keyframe: Keyframe) -> KeyframeMotion:
        """The motion of a stored keyframe. It is not looked for where all rows are of one moment, as far as is known."""
        times = self.times(keyframe)
        if keyframe.rectification is None and times.synchronised:
            return _as_tracked(keyframe, times)
        stamps, poses = self.frames.around(keyframe, STAMPS)
        least = _LEAST - 1 if keyframe.velocity is None else _LEAST  # the first keyframe has no frames before it
        found = motion_around(keyframe.timestamp, stamps, poses, times, least=least)
        return _as_tracked(keyframe, times) if found is None else replace(found, rectification=keyframe.rectification)


def motion_around(stamp: float, stamps: Array, poses: Array, times: RowTimes, *, least: int = _LEAST) -> KeyframeMotion | None:
    """The motion at one of the stamps (M,) [s] of poses T_wc (M, 4, 4), of images with these times that are not rectified.

    None where fewer than `least` of the poses are near it, or where they are too far apart to tell of a shaking hand.
    """
    interval = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    at = int(np.searchsorted(stamps, stamp))
    near = slice(max(at - _REACH, 0), at + _REACH + 1)
    if len(stamps[near]) < least or not 0 < interval < _SLOWEST:
        return None
    seconds = np.round((stamps[near] - stamp) / interval) * interval
    if (np.diff(seconds) <= 0).any():  # stamps that are no order
        return None
    velocity, acceleration = motion_through(seconds, np.linalg.inv(poses[at]) @ poses[near])
    return KeyframeMotion(times, velocity, _diagonal(_ERROR), acceleration, None)


def unknown_motion(times: RowTimes) -> KeyframeMotion:
    """The motion of a hand of which nothing is known, of images with these times that are not rectified."""
    return KeyframeMotion(times, np.zeros(6), _diagonal(HAND_SPEED), np.zeros(6), None)


def _as_tracked(keyframe: Keyframe, times: RowTimes) -> KeyframeMotion:
    if keyframe.velocity is None or keyframe.velocity_covariance is None:
        return replace(unknown_motion(times), rectification=keyframe.rectification)
    return KeyframeMotion(times, keyframe.velocity, keyframe.velocity_covariance + _diagonal(_ERROR), np.zeros(6), keyframe.rectification)


def motion_through(seconds: Array, poses: Array) -> tuple[Array, Array]:
    """Velocity (6,) and acceleration (6,) at time 0, along the camera's axes then, of poses (M, 4, 4) relative to it at times (M,) [s].

    Turns are large against their errors and follow a spline. Shifts are small against theirs, and are smoothed.
    """
    turn = CubicSpline(seconds, Rotation.from_matrix(poses[:, :3, :3]).as_rotvec())
    powers = seconds[:, None] ** np.arange(4)
    shift = np.linalg.lstsq(powers / np.abs(powers).max(0), poses[:, :3, 3], rcond=None)[0] / np.abs(powers).max(0)[:, None]
    return np.concatenate([shift[1], turn(0.0, 1)]), np.concatenate([2 * shift[2], turn(0.0, 2)])


def _diagonal(deviation: tuple[float, float]) -> Array:
    """(6, 6) covariance of shift and turn with these standard deviations in each direction."""
    return np.diag(np.repeat(np.array(deviation) ** 2, 3))
