"""The motion of a camera within an image, as landmarks show it: each is seen by the camera at the time of the row that shows it.

The pose that is adjusted is that of a keyframe's time stamp. Its images were carried there with a velocity, when they were rectified. If
that was wrong, or was not constant, a landmark is not where the image shows it. So with s the time of its row and v the true velocity, a
landmark p in the keyframe's frame is shown where exp(-(s v + r)) p is, where r is what the image was rectified by, and what is known of
the acceleration (Hedborg, Forssen, Felsberg and Ringaby, "Rolling shutter bundle adjustment", CVPR 2012). Colour's rows and depth's have
times of their own. Where these are estimates themselves, all keyframes of a recording share their errors (`TimeErrors`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.sensing.rectification import Rectification, RowTimes

Array = NDArray[np.float64]

_SEARCHES = 3  # steps in which the row of a raw image is found. More: nothing; each divides the error by more than ten
_NEAREST = 0.1  # [m] least depth of a point that is projected there. More: rows of near points are less exact


@dataclass(frozen=True)
class RowMotion:
    """Of N sightings of landmarks, in colour and in depth."""

    seconds: Array  # (N, 2) [s] from the keyframe's time stamp to when the row of colour was exposed, and that of depth
    given: Array  # (N, 2, 6) [m], [rad] displacement r to be added to seconds times the velocity
    acceleration: Array  # (N, 6) [m/s^2], [rad/s^2] of the camera: r contains it
    by_times: Array  # (N, 2, T) [1] derivatives of seconds by those times of the sensors that are not exact

    def __getitem__(self, chosen: NDArray[np.generic]) -> "RowMotion":
        return RowMotion(*(part[chosen] for part in vars(self).values()))

    def displacements(self, velocities: Array, times: Array) -> tuple[Array, Array, Array]:
        """Seconds (N, 2), displacements (N, 2, 6) and their rates (N, 2, 6) at velocities (N, 6), and with errors (T,) [s] of the times."""
        late = self.by_times @ times
        seconds, between = self.seconds + late, (self.seconds + late / 2)[..., None]
        acceleration = self.acceleration[:, None]
        moved = seconds[..., None] * velocities[:, None] + self.given + late[..., None] * between * acceleration
        return seconds, moved, velocities[:, None] + seconds[..., None] * acceleration


@dataclass(frozen=True)
class Velocities:
    """Of K keyframes: shift [m/s] and turn [rad/s] along the axes of each camera, with a Gaussian prior."""

    present: Array  # (K, 6)
    prior: Array  # (K, 6) its mean
    information: Array  # (K, 6, 6)

    @staticmethod
    def of(motions: "Sequence[KeyframeMotion]") -> "Velocities":
        """Those of keyframes at what is known of them."""
        mean = np.array([motion.velocity for motion in motions])
        return Velocities(mean, mean, np.asarray(np.linalg.inv([motion.covariance for motion in motions]), np.float64))

    @property
    def cost(self) -> float:
        """The squared distance to the prior, in units of its covariance."""
        off = self.present - self.prior
        return float(np.einsum("ki,kij,kj->", off, self.information, off))

    @property
    def right(self) -> Array:
        """(K, 6) what the prior adds to the right side of the normal equations."""
        return np.einsum("kij,kj->ki", self.information, self.prior - self.present)


@dataclass(frozen=True)
class TimeErrors:
    """The errors [s] of T times of sensors, which the rows of all keyframes of a recording share, with a Gaussian prior about zero."""

    present: Array  # (T,)
    information: Array  # (T,) [1/s^2]

    @staticmethod
    def none() -> "TimeErrors":
        """All times are exact."""
        return TimeErrors.of(np.zeros((0, 3)))

    @staticmethod
    def of(sigmas: Array) -> "TimeErrors":
        """Those of the inexact ones among times with standard deviations (R, 3) [s], in order."""
        inexact = sigmas[sigmas > 0]
        return TimeErrors(np.zeros(len(inexact)), inexact**-2)

    @property
    def cost(self) -> float:
        """The squared distance to the prior, in units of its covariance."""
        return float((self.information * self.present**2).sum())


def displaced(points: Array, xi: Array) -> tuple[Array, Array, Array]:
    """exp(-xi) p of points (N, 3) and xi (N, 6) to second order, with its derivatives by the point (N, 3, 3) and by xi (N, 3, 6)."""
    V, W = xi[:, :3], hat(xi[:, 3:])
    rate = V + (W @ points[:, :, None])[:, :, 0]
    moved = points - rate + (W @ rate[:, :, None])[:, :, 0] / 2
    by_rate = W / 2 - np.eye(3)
    by_turn = -by_rate @ hat(points) - hat(rate) / 2
    return moved, np.eye(3) + by_rate @ W, np.concatenate([by_rate, by_turn], 2)


def hat(p: Array) -> Array:
    """(N, 3, 3) the matrices of the cross product with vectors (N, 3)."""
    out = np.zeros((len(p), 3, 3))
    x, y, z = p.T
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -z, y, -x
    out[:, 1, 0], out[:, 2, 0], out[:, 2, 1] = z, -y, x
    return out


@dataclass(frozen=True, eq=False)
class KeyframeMotion:
    """How a camera moved while it took a keyframe, as far as is known, along its axes at the time stamp."""

    times: RowTimes  # of the images as they were taken
    velocity: Array  # (6,) shift [m/s] and turn [rad/s]
    covariance: Array  # (6, 6) of the velocity
    acceleration: Array  # (6,) [m/s^2], [rad/s^2]
    rectification: Rectification | None  # what its images were rectified with

    @property
    def synchronised(self) -> bool:
        """Whether its images show all landmarks where a synchronised global shutter would, whatever the velocity."""
        return self.rectification is None and self.times.synchronised

    def rows(self, points: Array, camera: Camera) -> RowMotion:
        """Of sightings of points (N, 3) in the keyframe's frame."""
        then = RowTimes() if self.rectification is None else self.rectification.times
        carried = np.zeros(6) if self.rectification is None else self.rectification.velocity
        f = [_rows_as_taken(points, start, span, carried, camera) for start, span in _spans(then)]
        before = np.stack([start + span * row for row, (start, span) in zip(f, _spans(then))], 1)
        seconds = np.stack([start + span * row for row, (start, span) in zip(f, _spans(self.times))], 1)
        given = seconds[..., None] ** 2 / 2 * self.acceleration - before[..., None] * carried
        by_times = np.zeros((len(points), 2, 3))  # colour's read-out, depth's, and depth's delay
        by_times[:, 0, 0], by_times[:, 1, 1], by_times[:, 1, 2] = *f, 1.0
        return RowMotion(seconds, given, np.tile(self.acceleration, (len(points), 1)), by_times)


def row_motion(points: Array, keyframe: NDArray[np.int64], motions: Sequence[KeyframeMotion], camera: Camera) -> RowMotion:
    """Of sightings of points (N, 3), each in the frame of its keyframe (N,), of these motions."""
    n = len(points)
    out = RowMotion(np.zeros((n, 2)), np.zeros((n, 2, 6)), np.zeros((n, 6)), np.zeros((n, 2, 3)))
    for k in np.unique(keyframe).tolist():
        chosen = keyframe == k
        for part, found in zip(vars(out).values(), vars(motions[k].rows(points[chosen], camera)).values()):
            part[chosen] = found
    return out


def with_inexact_times(rows: RowMotion, recording: NDArray[np.int64], sigmas: Array) -> RowMotion:
    """The same, of sightings in recordings (N,) whose sensors have times with standard deviations (R, 3) [s]: see `TimeErrors`."""
    by_times = np.zeros((*rows.seconds.shape, *sigmas.shape))
    by_times[np.arange(len(recording)), :, recording] = rows.by_times
    return replace(rows, by_times=by_times[..., sigmas > 0])


def _spans(times: RowTimes) -> tuple[tuple[float, float], tuple[float, float]]:
    """When the middle row was exposed, and how long all rows took [s], of colour and of depth."""
    return (0.0, times.readout), (times.depth_delay, times.depth_readout)


def _rows_as_taken(points: Array, start: float, span: float, velocity: Array, camera: Camera) -> Array:
    """(N,) the rows, from -0.5 to 0.5, in which an image showed points (N, 3) before it was rectified with this velocity (6,)."""
    row = _row(points, camera)
    for _ in range(_SEARCHES):
        row = _row(displaced(points, (start + span * row)[:, None] * velocity)[0], camera)
    return row


def _row(points: Array, camera: Camera) -> Array:
    """(N,) where points (N, 3) are in an image, from -0.5 at its top to 0.5 at its bottom."""
    v = camera.fy * points[:, 1] / np.maximum(points[:, 2], _NEAREST) + camera.cy
    return ((v + 0.5) / camera.height - 0.5).clip(-0.5, 0.5)
