"""The motion of a camera within an image, as landmarks show it: each is seen by the camera at the time of the row that shows it.

The pose that is adjusted is that of a keyframe's time stamp. Its images were carried there with a velocity, when they were rectified. If
that was wrong, or was not constant, a landmark is not where the image shows it. So with s the time of its row and v the true velocity, a
landmark p in the keyframe's frame is shown where exp(-(s v + r)) p is, where r is what the image was rectified by, and what is known of
the acceleration (Hedborg, Forssen, Felsberg and Ringaby, "Rolling shutter bundle adjustment", CVPR 2012). Colour's rows and depth's have
times of their own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

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

    def __getitem__(self, chosen: NDArray[np.generic]) -> "RowMotion":
        return RowMotion(self.seconds[chosen], self.given[chosen])


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
        return RowMotion(seconds, given)


def row_motion(points: Array, keyframe: NDArray[np.int64], motions: Sequence[KeyframeMotion], camera: Camera) -> RowMotion:
    """Of sightings of points (N, 3), each in the frame of its keyframe (N,), of these motions."""
    out = RowMotion(np.zeros((len(points), 2)), np.zeros((len(points), 2, 6)))
    for k in np.unique(keyframe).tolist():
        chosen = keyframe == k
        rows = motions[k].rows(points[chosen], camera)
        out.seconds[chosen], out.given[chosen] = rows.seconds, rows.given
    return out


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
