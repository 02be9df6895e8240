"""The residuals of a bundle adjustment, with analytic derivatives.

A landmark X, seen from a keyframe T_wk, has p = R^T (X - t) in its frame. It is measured where the image shows it, uv, and mostly by a
reading of depth there: the residuals are project(p) - uv and p_z - depth(reading), in standard deviations.
"""

from dataclasses import dataclass

import numpy as np

from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.observations import Array, Observations
from idfslam.adjustment.row_motion import RowMotion, displaced, hat

_EXACT = np.zeros(0)  # no time of a sensor is an unknown
_NEAREST = 1e-3  # [m] least depth of a point that is projected; raised, points near the camera do not count


@dataclass(frozen=True)
class Linearised:
    """Residuals of N observations [standard deviations], three each: two of the image, one of depth, 0 without a reading."""

    residuals: Array  # (N, 3)
    by_pose: Array  # (N, 3, 6) by xi, of T_wk exp(xi); (N, 3, 12) by xi and the keyframe's velocity, if that is an unknown
    by_point: Array  # (N, 3, 3)
    by_values: Array  # (N, 3, P) by the camera's values; (N, 3, P + T) by these and the errors of times that are unknowns


def camera_points(poses: Array, points: Array, seen: Observations) -> Array:
    """(N, 3) each observation's landmark, of points (L, 3) in the world, in the frame of its keyframe, of poses T_wk (K, 4, 4)."""
    T = poses[seen.keyframe]
    return np.einsum("nji,nj->ni", T[:, :3, :3], points[seen.landmark] - T[:, :3, 3])


def residuals(
    model: CameraModel, poses: Array, points: Array, seen: Observations, velocities: Array | None = None, times: Array = _EXACT
) -> Array:
    """(N, 3) as of `Linearised`. A landmark behind its keyframe has infinite ones."""
    return linearise(model, poses, points, seen, velocities, times).residuals


def linearise(
    model: CameraModel, poses: Array, points: Array, seen: Observations, velocities: Array | None = None, times: Array = _EXACT
) -> Linearised:
    """Residuals and derivatives of observations, of poses T_wk (K, 4, 4) and points (L, 3) in the world.

    velocities: (K, 6) of the keyframes, where `seen` has the times of rows. times: (T,) [s] errors of the sensors' times.
    """
    p = camera_points(poses, points, seen)
    if seen.rows is not None and velocities is not None:
        return _linearised_in_motion(model, poses[seen.keyframe, :3, :3], p, seen, seen.rows, velocities[seen.keyframe], times)
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
    by_pose = np.concatenate([-by_p, by_p @ hat(p)], 2)  # T exp(xi) moves the point to p - v - omega x p
    off[behind] = np.inf
    return Linearised(off, by_pose, by_p @ R.transpose(0, 2, 1), by_values)


def _linearised_in_motion(
    model: CameraModel, R: Array, p: Array, seen: Observations, rows: RowMotion, velocities: Array, times: Array
) -> Linearised:
    """The same of landmarks p (N, 3) at the time stamp of cameras with rotations R (N, 3, 3) and velocities (N, 6).

    A reading of depth where colour shows a landmark is that of another point of its surface, if depth's row moved on.
    """
    behind = p[:, 2] < _NEAREST
    p[behind] = 0, 0, 1
    seconds, moved, rates = rows.displacements(velocities, times)
    colour, depth = (displaced(p, moved[:, i]) for i in range(2))
    behind |= (colour[0][:, 2] < _NEAREST) | (depth[0][:, 2] < _NEAREST)
    uv, uv_by_colour, uv_by_values = model.project(colour[0])
    uv_then, uv_by_depth, _ = model.project(depth[0])
    stated, depth_by_values = model.depth(seen.uv, seen.reading)
    z = depth[0][:, 2] + ((uv - uv_then) * seen.slope).sum(1)
    weight = np.where(seen.reading > 0, 1 / seen.reading_sigma, 0.0)
    off = np.concatenate([np.einsum("nij,nj->ni", seen.root, uv - seen.uv), (weight * (z - stated))[:, None]], 1)
    slope = seen.slope[:, None]
    z_by_colour, z_by_depth = weight[:, None, None] * (slope @ uv_by_colour), weight[:, None, None] * ([0.0, 0, 1] - slope @ uv_by_depth)
    by_colour = np.concatenate([seen.root @ uv_by_colour, z_by_colour], 1)
    by_depth = np.concatenate([np.zeros((len(p), 2, 3)), z_by_depth], 1)
    by_p = by_colour @ colour[1] + by_depth @ depth[1]
    by_moved = np.stack([by_colour @ colour[2], by_depth @ depth[2]], 1)
    by_velocity = (seconds[:, :, None, None] * by_moved).sum(1)
    by_times = np.einsum("nkij,nkj,nkt->nit", by_moved, rates, rows.by_times)
    by_values = np.concatenate([seen.root @ uv_by_values, -(weight[:, None] * depth_by_values)[:, None]], 1)
    off[behind] = np.inf
    by_pose = np.concatenate([-by_p, by_p @ hat(p), by_velocity], 2)
    return Linearised(off, by_pose, by_p @ R.transpose(0, 2, 1), np.concatenate([by_values, by_times], 2))
