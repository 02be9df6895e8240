"""A depth image as it is fused: with the slant of the surface at each reading, and the reading's information.

The slant is that of a plane through the readings around. The inverse depth of a plane is linear in the image, so the plane is a linear
regression of inverse depths.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.compute.backend import pick
from idfslam.fusion.constants import LEAST_SLANT
from idfslam.geometry.camera import Camera
from idfslam.geometry.depth_view import DepthView
from idfslam.geometry.projection import intrinsics_of
from idfslam.sensing.depth_edges import EDGE, EDGE_SHARE
from idfslam.sensing.depth_noise import BEST, noise_ratio

Floats = NDArray[np.float32]

REACH = 2  # [px] rows and columns around a reading that its plane is fitted to. More: smoother slants, less detail. Chosen by hand
_LEAST_READINGS = 6  # readings that a plane needs; fewer: the surface counts as slanted as can be. More: edges count less. Chosen by hand


@dataclass(frozen=True, eq=False)
class PreparedDepth:
    """A depth image, with what fusion needs of each reading."""

    depth: Floats  # (H, W) [m], 0: no reading
    slope: Floats  # (H, W) distance to the surface's plane over the difference of depth along a ray: ray . normal, where the ray has z = 1
    information: Floats  # (H, W) [1/m^2] of the distance to the plane
    camera: Camera
    T_wc: NDArray[np.float64]  # (4, 4)


def prepared(view: DepthView) -> PreparedDepth:
    """The view with slants and information."""
    slope, information = planes(view.depth, view.camera, *inverse_depth_slopes(view.depth))
    return PreparedDepth(view.depth, slope, information, view.camera, view.T_wc)


def planes(depth: Floats, camera: Camera, along_u: Floats, along_v: Floats, count: NDArray[np.int32]) -> tuple[Floats, Floats]:
    """`slope` and `information` (H, W) of a `PreparedDepth`, from the slopes (H, W) of inverse depth and the number of their readings."""
    form = pick(torch.empty(0), compiled=compiled_planes, plain=plain_planes)
    return form(depth, camera, along_u, along_v, count)


def compiled_planes(depth: Floats, camera: Camera, along_u: Floats, along_v: Floats, count: NDArray[np.int32]) -> tuple[Floats, Floats]:
    """`planes`, compiled by Numba."""
    from idfslam.fusion.kernels.numba_slopes import planes as fill

    slope, information = np.zeros_like(depth), np.zeros_like(depth)
    intrinsics = tuple(np.float32(value) for value in intrinsics_of(camera))
    readings = _LEAST_READINGS, (2 * REACH + 1) ** 2
    fill(np.ascontiguousarray(depth), intrinsics, along_u, along_v, count, readings, slope, information)
    return slope, information


def plain_planes(depth: Floats, camera: Camera, along_u: Floats, along_v: Floats, count: NDArray[np.int32]) -> tuple[Floats, Floats]:
    """`planes` in numpy."""
    c, read = camera, depth > 0
    q = 1 / np.where(read, depth, 1)
    u, v = np.arange(c.width, dtype=np.float32), np.arange(c.height, dtype=np.float32)[:, None]
    # The plane n . p = 1 has q = n . ray, so n = (dq/du fx, dq/dv fy, rest)
    normal_x, normal_y = along_u * np.float32(c.fx), along_v * np.float32(c.fy)
    ray_x, ray_y = (u - np.float32(c.cx)) / np.float32(c.fx), (v - np.float32(c.cy)) / np.float32(c.fy)
    normal_z = q - normal_x * ray_x - normal_y * ray_y
    length = np.sqrt(1 + ray_x**2 + ray_y**2)
    cosine = q / (np.sqrt(normal_x**2 + normal_y**2 + normal_z**2) * length)
    cosine = np.where(count >= _LEAST_READINGS, np.maximum(cosine, LEAST_SLANT), LEAST_SLANT).astype(np.float32)
    slope = np.where(read, cosine * length, 0).astype(np.float32)
    sigma = BEST * noise_ratio(torch.from_numpy(depth)).numpy() * length
    inner = count / np.float32((2 * REACH + 1) ** 2)  # towards an edge it falls: there a pixel may show either side
    information = np.where(read, (cosine / sigma) ** 2 * inner, 0).astype(np.float32)
    return slope, information


def inverse_depth_slopes(depth: Floats) -> tuple[Floats, Floats, NDArray[np.int32]]:
    """The slopes (H, W) [1/(m px)] of inverse depth along the columns and the rows, and the number of readings (H, W) that they come from.

    Readings beyond an edge (`depth_edges`) belong to another surface and take no part.
    """
    return pick(torch.empty(0), compiled=compiled_inverse_depth_slopes, plain=plain_inverse_depth_slopes)(depth)


def compiled_inverse_depth_slopes(depth: Floats) -> tuple[Floats, Floats, NDArray[np.int32]]:
    """`inverse_depth_slopes`, compiled by Numba."""
    from idfslam.fusion.kernels.numba_slopes import slopes

    along_u, along_v, count = np.zeros_like(depth), np.zeros_like(depth), np.zeros(depth.shape, np.int32)
    depth, inverse = np.ascontiguousarray(depth), 1 / np.where(depth > 0, depth, np.float32(1))
    window, steps = np.ones(2 * REACH + 1, np.float32), np.arange(-REACH, REACH + 1, dtype=np.float32)
    low, high = (form(depth, np.outer(window, window)) for form in (cv2.erode, cv2.dilate))
    along = steps / (window.sum() * (steps**2).sum())  # of a regression over a whole window
    whole = np.stack([cv2.sepFilter2D(inverse, cv2.CV_32F, *kernels) for kernels in ((along, window), (window, along))])
    slopes(depth, inverse, low, high, whole, REACH, EDGE, EDGE_SHARE, along_u, along_v, count)
    return along_u, along_v, count


def plain_inverse_depth_slopes(depth: Floats) -> tuple[Floats, Floats, NDArray[np.int32]]:
    """`inverse_depth_slopes` in numpy."""
    padded = np.pad(depth.astype(np.float64), REACH)
    height, width = depth.shape
    sums = np.zeros((9, height, width))
    for j in range(2 * REACH + 1):
        for i in range(2 * REACH + 1):
            z = padded[j : j + height, i : i + width]
            used = (z > 0) & (depth > 0) & (np.abs(z - depth) < EDGE + EDGE_SHARE * depth)
            q, u, v = np.where(used, 1 / np.where(z > 0, z, 1), 0), (i - REACH) * used, (j - REACH) * used
            sums += np.stack([used, u, v, q, u * u, u * v, v * v, u * q, v * q])
    n = np.maximum(sums[0], 1)
    u, v, q = sums[1] / n, sums[2] / n, sums[3] / n
    uu, uv, vv, uq, vq = sums[4] / n - u * u, sums[5] / n - u * v, sums[6] / n - v * v, sums[7] / n - u * q, sums[8] / n - v * q
    determinant = uu * vv - uv * uv
    fits = determinant > 1e-3
    determinant = np.where(fits, determinant, 1)
    along_u, along_v = np.where(fits, (vv * uq - uv * vq) / determinant, 0), np.where(fits, (uu * vq - uv * uq) / determinant, 0)
    return along_u.astype(np.float32), along_v.astype(np.float32), np.where(fits, sums[0], 0).astype(np.int32)
