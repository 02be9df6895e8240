"""The tracker's inner loops on the CPU, compiled by Numba. The plain forms are in `tracking/matching.py` and `point_to_plane.py`."""

import numpy as np
from numba import njit

from idfslam.sensing.depth_noise import GROWTH, NEAREST

_FASTMATH = {"nnan", "nsz", "reassoc", "contract", "arcp"}
_compiled = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy")
_NEAREST, _GROWTH = np.float32(NEAREST), np.float32(GROWTH)
_BLOCK = 64  # values whose maximum is computed first, by vector instructions


@_compiled
def two_largest(values, indices) -> None:  # type: ignore[no-untyped-def]
    """Fills indices (N, 2) with those of the two largest values in each row of values (N, M), M >= 2, the largest first."""
    columns = values.shape[1]
    for n in range(len(values)):
        row = values[n]
        i, j = (0, 1) if row[0] >= row[1] else (1, 0)
        first, second = row[i], row[j]
        for start in range(2, columns, _BLOCK):
            block = row[start : start + _BLOCK]
            largest = block[0]
            for m in range(len(block)):
                largest = max(largest, block[m])
            if largest <= second:
                continue  # most blocks end here, after the first few
            for m in range(len(block)):
                if block[m] > first:
                    second, j = first, i
                    first, i = block[m], start + m
                elif block[m] > second:
                    second, j = block[m], start + m
        indices[n, 0], indices[n, 1] = i, j


@_compiled
def plane_system(T, points, normals, stride, to_points, to_normals, camera, reach, facing, noise, robust, H, b):  # type: ignore[no-untyped-def] # noqa: C901 (one test a reason to leave a point out)
    """Adds to H (6, 6), b (6,) the distances of the points (h, w, 3) of one image to the planes of another, at T (4, 4).

    Every `stride`-th row and column takes part. camera: fx, fy, cx, cy of the other image. noise: least standard deviation [m] of the
    difference of two readings.
    """
    fx, fy, cx, cy = camera
    rows, columns = to_points.shape[:2]
    J = np.empty(6)
    for row in range(stride // 2, points.shape[0], stride):
        for column in range(stride // 2, points.shape[1], stride):
            n = normals[row, column]
            if n[2] == 0:
                continue
            p = points[row, column]
            x = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
            y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
            z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
            if z <= 0:
                continue
            u, v = int(np.rint(x / z * fx + cx)), int(np.rint(y / z * fy + cy))
            if u < 0 or u >= columns or v < 0 or v >= rows:
                continue
            m, q = to_normals[v, u], to_points[v, u]
            dx, dy, dz = x - q[0], y - q[1], z - q[2]
            distance = dx * m[0] + dy * m[1] + dz * m[2]
            if abs(distance) >= reach or dx * dx + dy * dy + dz * dz >= 4 * reach * reach:
                continue
            cosine = np.float32(0)
            for axis in range(3):
                cosine += m[axis] * (T[axis, 0] * n[0] + T[axis, 1] * n[1] + T[axis, 2] * n[2])
            if cosine <= facing:
                continue
            beyond = max(z - _NEAREST, np.float32(0))
            sigma = noise * (1 + _GROWTH * beyond * beyond)
            off = distance / (robust * sigma)
            root = 1 / (sigma * (1 + off * off))
            J[0], J[1], J[2] = m[0], m[1], m[2]
            J[3], J[4], J[5] = m[2] * y - m[1] * z, m[0] * z - m[2] * x, m[1] * x - m[0] * y
            for i in range(6):
                weighted = root * root * J[i]
                b[i] -= weighted * distance
                for j in range(i, 6):
                    H[i, j] += weighted * J[j]
    for i in range(6):
        for j in range(i):
            H[i, j] = H[j, i]
