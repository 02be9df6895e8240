"""Depth L1: depth images of the reconstruction against those of the true surface, from views within the room.

As in NICE-SLAM: 500 x 500 pixels, f = 300, random directions, depth up to 20 m; the error is the mean over views of the mean over pixels
that show true surface. Two things differ, so that any recording can be evaluated without files made by hand. Views are up to 0.5 m from the
recorded camera centres (NICE-SLAM draws them in a box chosen for Replica). Pixels that show true surface culled by the protocol are left
out (NICE-SLAM draws new views until none shows any). Every tenth row and column is cast: 2500 pixels a view.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idfslam.evaluation.culling import free_positions
from idfslam.geometry.camera import Camera
from idfslam.geometry.ray_casting import RayCaster, pixel_rays

_CAMERA = Camera(50, 50, 30.0, 30.0, 24.5, 24.5)  # NICE-SLAM's 500 x 500 pixels, f = 300, at a tenth of the resolution
_FAR = 20.0  # [m] beyond which surface does not count; raised, far surface weighs more. NICE-SLAM's value
_REACH = 0.5  # [m] of a view from a recorded camera centre; raised, views show more surface that was seldom seen. Chosen by hand
_MIN_SHARE = 0.01  # [1] share of a view's pixels that must show true surface; raised, fewer views count. Chosen by hand


@dataclass(frozen=True)
class DepthError:
    """Depth errors over the pixels that show true surface."""

    l1: float  # [m] over pixels where the reconstruction has a surface; NaN if there are none
    l1_with_missing: float  # [m] over all of them; a pixel without reconstruction has depth 0, as in NICE-SLAM's renderer
    missing: float  # share of pixels where the reconstruction has no surface
    views: int  # the number of views that showed true surface


def depth_error(
    reconstruction: RayCaster, truth: RayCaster, truth_kept: NDArray[np.bool_], poses: NDArray[np.float64], *, views: int, seed: int
) -> DepthError | None:
    """Depth errors over `views` random views around poses (N, 4, 4); None if no view shows true surface.

    truth_kept: (F,) which faces of the true mesh count.
    """
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
    if counted.mean() < _MIN_SHARE:
        return None
    depth = reconstruction.cast(origin, rays[counted]).distance
    reconstructed = depth < _FAR
    expected = true.distance[counted]
    error = np.abs(np.where(reconstructed, depth, 0) - expected)
    return float(error[reconstructed].mean()) if reconstructed.any() else float("nan"), float(error.mean()), float(1 - reconstructed.mean())
