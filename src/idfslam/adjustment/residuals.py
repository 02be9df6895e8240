"""The measurements of a bundle adjustment, and their residuals with analytic derivatives.

A landmark X, seen from a keyframe T_wk, has p = R^T (X - t) in its frame. It is measured where the image shows it, uv, and mostly by a
reading of depth there: the residuals are project(p) - uv and p_z - depth(reading), in standard deviations.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from idfslam.adjustment.camera_model import CameraModel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_NEAREST = 1e-3  # [m] least depth of a point that is projected; raised, points near the camera do not count


@dataclass(frozen=True)
class Observations:
    """N sightings of landmarks in keyframes, sorted by landmark, then by keyframe. Each pair occurs once."""

    keyframe: Indices  # (N,)
    landmark: Indices  # (N,)
    uv: Array  # (N, 2) [px]
    root: Array  # (N, 2, 2) [1/px] square roots of the information of uv: root^T root
    reading: Array  # (N,) [m] depth as the sensor states it; 0: none
    reading_sigma: Array  # (N,) [m] its standard deviation

    def __len__(self) -> int:
        return len(self.keyframe)

    def __getitem__(self, chosen: NDArray[np.generic]) -> "Observations":
        parts = self.keyframe, self.landmark, self.uv, self.root, self.reading, self.reading_sigma
        return Observations(*(part[chosen] for part in parts))  # type: ignore[arg-type]


def tracks(points: Array, seen: Observations) -> tuple[Array, Observations]:
    """Those of landmarks (L, 3) that two keyframes see, and that three measurements or more determine, and their observations."""
    counts = np.bincount(seen.landmark, minlength=len(points))
    readings = np.bincount(seen.landmark, weights=seen.reading > 0, minlength=len(points))
    kept = (counts >= 2) & (counts + readings >= 3)
    numbers = np.cumsum(kept) - 1
    seen = seen[kept[seen.landmark]]
    return points[kept], replace(seen, landmark=numbers[seen.landmark])


@dataclass(frozen=True)
class Linearised:
    """Residuals of N observations [standard deviations], three each: two of the image, one of depth, 0 without a reading."""

    residuals: Array  # (N, 3)
    by_pose: Array  # (N, 3, 6) by xi, of T_wk exp(xi)
    by_point: Array  # (N, 3, 3)
    by_values: Array  # (N, 3, P) by the camera's values


def camera_points(poses: Array, points: Array, seen: Observations) -> Array:
    """(N, 3) each observation's landmark, of points (L, 3) in the world, in the frame of its keyframe, of poses T_wk (K, 4, 4)."""
    T = poses[seen.keyframe]
    return np.einsum("nji,nj->ni", T[:, :3, :3], points[seen.landmark] - T[:, :3, 3])


def residuals(model: CameraModel, poses: Array, points: Array, seen: Observations) -> Array:
    """(N, 3) as of `Linearised`. A landmark behind its keyframe has infinite ones."""
    return linearise(model, poses, points, seen).residuals


def linearise(model: CameraModel, poses: Array, points: Array, seen: Observations) -> Linearised:
    """Residuals and derivatives of observations, of poses T_wk (K, 4, 4) and points (L, 3) in the world."""
    p = camera_points(poses, points, seen)
    behind = p[:, 2] < _NEAREST
    p[behind] = 0, 0, 1
    uv, uv_by_p, uv_by_values = model.project(p)
    depth, depth_by_values = model.depth(seen.uv, seen.reading)
    weight = np.where(seen.reading > 0, 1 / seen.reading_sigma, 0.0)
    off = np.concatenate([np.einsum("nij,nj->ni", seen.root, uv - seen.uv), (weight * (p[:, 2] - depth))[:, None]], 1)
    by_p = np.zeros((len(p), 3, 3))
    by_p[:, :2], by_p[:, 2, 2] = seen.root @ uv_by_p, weight
    by_values = np.concatenate([seen.root @ uv_by_values, -(weight[:, None] * depth_by_values)[:, None]], 1)
    R = poses[seen.keyframe, :3, :3]
    by_pose = np.concatenate([-by_p, by_p @ _hat(p)], 2)  # T exp(xi) moves the point to p - v - omega x p
    off[behind] = np.inf
    return Linearised(off, by_pose, by_p @ R.transpose(0, 2, 1), by_values)


def _hat(p: Array) -> Array:
    """(N, 3, 3) the matrices of the cross product with vectors (N, 3)."""
    out = np.zeros((len(p), 3, 3))
    x, y, z = p.T
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -z, y, -x
    out[:, 1, 0], out[:, 2, 0], out[:, 2, 1] = z, -y, x
    return out
