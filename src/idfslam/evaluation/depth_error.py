"""Depth L1: depth images of the reconstruction against those of the true surface, from views within the room.

After NICE-SLAM: 500 x 500 pixels, f = 300, random directions, depth up to 20 m, the mean over views of the mean over pixels that show
true surface. Two things differ, so that any recording works without files made for it by hand: views stand up to 0.5 m from the recorded
camera centres (NICE-SLAM draws in a box tuned to Replica), and pixels that show true surface culled by the protocol are left out
(NICE-SLAM draws views until none shows any). Every tenth pixel is cast, both ways: 2500 a view.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idfslam.evaluation.culling import free_positions
from idfslam.geometry.camera import Camera
from idfslam.geometry.ray_casting import RayCaster, pixel_rays

_CAMERA = Camera(50, 50, 30.0, 30.0, 24.5, 24.5)  # 500 x 500, f = 300 at a tenth of the resolution
_FAR = 20.0  # [m]
_REACH = 0.5  # [m] of a view from a recorded camera centre
_FEWEST = 0.01  # share of a view's pixels that must show true surface


@dataclass(frozen=True)
class DepthError:
    """Over the pixels that show true surface."""

    l1: float  # [m], where the reconstruction has a surface
    l1_with_missing: float  # [m], pixels without reconstruction counting with depth 0, as NICE-SLAM's renderer gives them
    missing: float  # share of pixels where the reconstruction has no surface
    views: int  # that showed true surface


def depth_error(
    reconstruction: RayCaster, truth: RayCaster, truth_kept: NDArray[np.bool_], poses: NDArray[np.float64], *, views: int, seed: int
) -> DepthError | None:
    """Of `views` random views around poses (N, 4, 4); `truth_kept` (F,) marks the truth's faces that count. None if no view shows any."""
    T_wv = np.tile(np.eye(4), (views, 1, 1))
    T_wv[:, :3, 3] = free_positions(truth, poses, count=views, reach=_REACH, seed=seed)
    T_wv[:, :3, :3] = Rotation.random(views, random_state=np.random.default_rng(seed + 1)).as_matrix() if views else T_wv[:, :3, :3]
    rows = [row for T in T_wv if (row := _view_error(reconstruction, truth, truth_kept, T)) is not None]
    if not rows:
        return None
    l1, with_missing, missing = np.array(rows).T
    return DepthError(
        float(np.nanmean(l1)) if np.isfinite(l1).any() else float("nan"), float(with_missing.mean()), float(missing.mean()), len(rows)
    )


def _view_error(
    reconstruction: RayCaster, truth: RayCaster, truth_kept: NDArray[np.bool_], T_wv: NDArray[np.float64]
) -> tuple[float, float, float] | None:
    origin, rays = T_wv[:3, 3].astype(np.float32), pixel_rays(_CAMERA, T_wv)
    true = truth.cast(origin, rays)
    counted = (true.face >= 0) & truth_kept[true.face] & (true.distance < _FAR)
    if counted.mean() < _FEWEST:
        return None
    depth = reconstruction.cast(origin, rays[counted]).distance
    found = depth < _FAR
    expected = true.distance[counted]
    error = np.abs(np.where(found, depth, 0) - expected)
    return float(error[found].mean()) if found.any() else float("nan"), float(error.mean()), float(1 - found.mean())
