"""Registers depth images to the colour camera: each reading moves to the pixels where the colour camera sees it; the nearest reading wins.

A reading covers its whole pixel, so that a surface has no gaps where the colour image has more pixels than the depth image. Nothing is
interpolated.
"""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import DepthCameraCalibration
from idfslam.datasets.images.decoding import Depth, readings
from idfslam.geometry.camera import Camera
from idfslam.geometry.projection import to_pixel

_STEPS = 30  # most iterations of undistortion; raised, very wide lenses converge too. Chosen by hand
_RESIDUAL = 0.01  # [px] at which undistortion ends; raised, rays are less exact. Chosen by hand


class DepthRegistration:
    """Called with a depth image (h, w) of the depth camera; returns z-depth (H, W) float32 of the colour camera, in the same units."""

    def __init__(self, depth: DepthCameraCalibration, size: tuple[int, int], colour: Camera, scale: float, name: str) -> None:
        """size: (w, h) [px] of the depth images. colour: without distortion. scale: depth units per metre. name: the recording's."""
        camera = depth.calibration.camera(*size, name)
        R, t = depth.T_colour_depth[:3, :3], depth.T_colour_depth[:3, 3]
        corners = _rays(camera, depth.calibration.distortion, offset=-0.5, grow=1) @ R.T
        centres = _rays(camera, depth.calibration.distortion, offset=0.0, grow=0) @ R.T
        self._corners, self._z = corners.astype(np.float32), centres[..., 2].astype(np.float32)
        self._t = (t * scale).astype(np.float32)
        self._colour = colour

    def __call__(self, raw: Depth) -> NDArray[np.float32]:
        image = np.where(readings(raw), raw, 0).astype(np.float32)
        camera = self._colour
        registered: NDArray[np.float32] = _splat(
            image, self._corners, self._z, self._t, camera.height, camera.width, camera.fx, camera.fy, camera.cx, camera.cy
        )
        return registered


def _rays(camera: Camera, distortion: tuple[float, ...] | None, *, offset: float, grow: int) -> NDArray[np.float64]:
    """(h + grow, w + grow, 3) ray directions with z = 1 through pixel coordinates plus `offset` [px]; distortion is undone."""
    v, u = np.mgrid[: camera.height + grow, : camera.width + grow].astype(np.float64) + offset
    pixels, f = np.stack([u, v], -1).reshape(-1, 2), np.array([camera.fx, camera.fy])
    xy = (pixels - [camera.cx, camera.cy]) / f
    for _ in range(_STEPS if distortion else 0):  # cv2.undistortPoints stops after five, half a pixel off in a wide lens
        distorted, _ = cv2.projectPoints(
            np.c_[xy, np.ones(len(xy))], np.zeros(3), np.zeros(3), camera.matrix().numpy(), np.array(distortion)
        )
        residual = pixels - distorted.reshape(-1, 2)
        xy += residual / f
        if np.abs(residual).max() < _RESIDUAL:
            break
    return np.concatenate([xy.reshape(*u.shape, 2), np.ones((*u.shape, 1))], -1)


@njit(cache=True, nogil=True, error_model="numpy")
def _splat(depth, corners, z_ray, t, height, width, fx, fy, cx, cy):  # type: ignore[no-untyped-def]
    """Gives each pixel of the colour image the smallest z of all depth pixels whose footprints contain its centre."""
    out = np.zeros((height, width), np.float32)
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            d = depth[v, u]
            z = d * z_ray[v, u] + t[2]
            if d <= 0 or z <= 0:
                continue
            left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
            for k in range(4):
                ray = corners[v + k // 2, u + k % 2]
                z_corner = d * ray[2] + t[2]
                if z_corner <= 0:
                    left, right = -np.inf, np.inf  # the pixel reaches behind the camera
                    break
                x, y = to_pixel(d * ray[0] + t[0], d * ray[1] + t[1], z_corner, fx, fy, cx, cy)
                left, right, top, bottom = min(left, x), max(right, x), min(top, y), max(bottom, y)
            if not (right > -1 and left < width and bottom > -1 and top < height and right - left < width):
                continue
            for y in range(max(0, np.ceil(top)), min(height, np.ceil(bottom))):
                for x in range(max(0, np.ceil(left)), min(width, np.ceil(right))):
                    if out[y, x] == 0 or z < out[y, x]:
                        out[y, x] = z
    return out
