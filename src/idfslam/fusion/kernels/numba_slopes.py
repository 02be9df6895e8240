"""The slopes of inverse depth in a depth image, and the planes that they tell, compiled by Numba. `prepared_depth` has the plain forms.

They run in one thread, beside the integration of the image before (`compute/ahead.py`).
"""

import numpy as np
from numba import njit

from idfslam.fusion.constants import LEAST_SLANT
from idfslam.sensing.depth_noise import BEST, GROWTH
from idfslam.sensing.depth_noise import NEAREST as SHARPEST

_LEAST_SLANT, _BEST, _GROWTH, _SHARPEST = np.float32(LEAST_SLANT), np.float32(BEST), np.float32(GROWTH), np.float32(SHARPEST)
_ZERO, _ONE = np.float32(0), np.float32(1)


@njit(cache=True, nogil=True, error_model="numpy")
def slopes(depth, inverse, low, high, whole, reach, edge, edge_share, along_u, along_v, count):  # type: ignore[no-untyped-def]
    """Fills the slopes (H, W) [1/(m px)] and the number of readings (H, W): regressions over windows of `reach` pixels each way.

    inverse (H, W) [1/m] of depth. low, high (H, W): least and largest depth in each window. whole (2, H, W): the slopes along columns and
    rows where all readings of a window count, which they do nearly everywhere.
    """
    height, width = depth.shape
    for row in range(height):
        for column in range(width):
            z = depth[row, column]
            if z <= 0:
                continue
            most = edge + edge_share * z
            inside = reach <= row < height - reach and reach <= column < width - reach
            if inside and low[row, column] > 0 and z - low[row, column] < most and high[row, column] - z < most:
                along_u[row, column], along_v[row, column] = whole[0, row, column], whole[1, row, column]
                count[row, column] = (2 * reach + 1) ** 2
                continue
            n, su, sv, sq, suu, suv, svv, suq, svq = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(max(row - reach, 0), min(row + reach + 1, height)):
                for i in range(max(column - reach, 0), min(column + reach + 1, width)):
                    if depth[j, i] <= 0 or abs(depth[j, i] - z) >= most:
                        continue
                    u, v, q = float(i - column), float(j - row), inverse[j, i]
                    n += 1
                    su += u
                    sv += v
                    sq += q
                    suu += u * u
                    suv += u * v
                    svv += v * v
                    suq += u * q
                    svq += v * q
            u, v, q = su / n, sv / n, sq / n
            uu, uv, vv, uq, vq = suu / n - u * u, suv / n - u * v, svv / n - v * v, suq / n - u * q, svq / n - v * q
            determinant = uu * vv - uv * uv
            if determinant > 1e-3:
                along_u[row, column] = (vv * uq - uv * vq) / determinant
                along_v[row, column] = (uu * vq - uv * uq) / determinant
                count[row, column] = int(n)


@njit(cache=True, nogil=True, error_model="numpy")
def planes(depth, intrinsics, along_u, along_v, count, readings, slope, information):  # type: ignore[no-untyped-def]
    """Fills slope and information (H, W) of readings: `prepared_depth.plain_planes`.

    readings: number that a plane needs, and largest number.
    """
    fx, fy, cx, cy = intrinsics
    least, most = readings
    height, width = depth.shape
    for row in range(height):
        ray_y = (np.float32(row) - cy) / fy
        for column in range(width):
            z = depth[row, column]
            if z <= _ZERO:
                continue
            ray_x, q = (np.float32(column) - cx) / fx, _ONE / z
            length = np.sqrt(_ONE + ray_x * ray_x + ray_y * ray_y)
            cosine = _LEAST_SLANT
            if count[row, column] >= least:
                normal_x, normal_y = along_u[row, column] * fx, along_v[row, column] * fy
                normal_z = q - normal_x * ray_x - normal_y * ray_y
                cosine = max(q / (np.sqrt(normal_x * normal_x + normal_y * normal_y + normal_z * normal_z) * length), _LEAST_SLANT)
            beyond = max(z - _SHARPEST, _ZERO)
            sharpness = cosine / (_BEST * (_ONE + _GROWTH * beyond * beyond) * length)
            share = np.float32(count[row, column]) / np.float32(most)
            slope[row, column] = cosine * length
            information[row, column] = sharpness * sharpness * share
