"""Pyramids that show where cameras are and what they see."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera

_FRUSTUM_DEPTH = 0.08  # [m] depth of the pyramid that is drawn for a keyframe; larger: easier to see, and they overlap


def frustums(T_wk: NDArray[np.float64], cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """A pyramid for each of K cameras at T_wk (K, 4, 4), drawn as one line (K, 11, 3) [m] along its edges."""
    lines = {camera: _frustum(camera) for camera in set(cameras)}
    points = np.array([lines[camera] for camera in cameras]).reshape(-1, 11, 3)
    return (T_wk[:, None, :3, :3] @ points[..., None])[..., 0] + T_wk[:, None, :3, 3]


def _frustum(camera: Camera) -> NDArray[np.float64]:
    """The pyramid (11, 3) [m] in the camera's own frame."""
    left, right = (np.array([0, camera.width]) - 0.5 - camera.cx) / camera.fx
    top, bottom = (np.array([0, camera.height]) - 0.5 - camera.cy) / camera.fy
    apex, a, b, c, d = np.array([[0, 0, 0], [left, top, 1], [right, top, 1], [right, bottom, 1], [left, bottom, 1]]) * _FRUSTUM_DEPTH
    return np.array([apex, a, b, apex, c, b, c, d, apex, d, a])
