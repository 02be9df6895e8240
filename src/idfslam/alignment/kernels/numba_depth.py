"""Depth on the CPU, compiled by Numba: points of a frame, the map's normals and distances at them, and their normal equations.

The plain forms are in the modules that call these. The alignment of a frame asks for ten equations of a few thousand points. In torch the
calls would cost more than the arithmetic.
"""

import numpy as np
from numba import njit

from idfslam.alignment.constants import LEAST_SLOPE, MAPPED, SLOPE_FLOOR
from idfslam.alignment.kernels.moving_points import along_axes, carry, numbers
from idfslam.alignment.kernels.normal_equations import fill_sums
from idfslam.sensing import depth_noise

_NEAREST_READING, _GROWTH = np.float32(depth_noise.NEAREST), np.float32(depth_noise.GROWTH)
_FASTMATH = {"contract", "reassoc", "nsz", "arcp"}
_compiled = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy")


@_compiled
def smoothed_normals(  # type: ignore[no-untyped-def] # noqa: C901 (into images, their sums, and back)
    points, gradient, patches, reach, alike, coplanar, normal, slope
) -> None:
    """Fills slope (N,) with the lengths of the gradients (N, 3) at points (N, 3), and normal (N, 3) with their smoothed directions.

    A direction is averaged with the similar ones in neighbouring patches (rows, columns): `normals.plain_smoothed`. All lie in images with
    a border, so that the innermost loop has no branches. A patch without a point has the direction 0, which is similar to none.
    """
    rows, columns = patches.shape
    unit = np.zeros((3, rows + 2 * reach, columns + 2 * reach), np.float32)
    place = np.zeros_like(unit)
    for i in range(rows):
        for j in range(columns):
            n = patches[i, j]
            if n >= 0:
                slope[n] = np.sqrt(gradient[n, 0] ** 2 + gradient[n, 1] ** 2 + gradient[n, 2] ** 2)
                for axis in range(3):
                    unit[axis, i + reach, j + reach] = gradient[n, axis] / max(slope[n], np.float32(1e-9))
                    place[axis, i + reach, j + reach] = points[n, axis]
    total = np.empty((3, columns), np.float32)
    for i in range(rows):
        total[:] = np.float32(0)
        here, at = unit[:, i + reach, reach : reach + columns], place[:, i + reach, reach : reach + columns]
        a, b, c, x, y, z = here[0], here[1], here[2], at[0], at[1], at[2]
        for down in range(2 * reach + 1):
            for right in range(2 * reach + 1):
                there, at = unit[:, i + down, right : right + columns], place[:, i + down, right : right + columns]
                d, e, f, u, v, w = there[0], there[1], there[2], at[0], at[1], at[2]
                for j in range(columns):
                    off = a[j] * (u[j] - x[j]) + b[j] * (v[j] - y[j]) + c[j] * (w[j] - z[j])
                    similar = (a[j] * d[j] + b[j] * e[j] + c[j] * f[j] >= alike) & (abs(off) < coplanar)
                    share = np.float32(1) if similar else np.float32(0)
                    total[0, j] += share * d[j]
                    total[1, j] += share * e[j]
                    total[2, j] += share * f[j]
        for j in range(columns):
            n = patches[i, j]
            if n >= 0:
                length = max(np.sqrt(total[0, j] ** 2 + total[1, j] ** 2 + total[2, j] ** 2), np.float32(1e-9))
                for axis in range(3):
                    normal[n, axis] = total[axis, j] / length


@_compiled
def depth_system(turned, distance, normal, slope, sigma, rows, truncation, robust, widest, H, b):  # type: ignore[no-untyped-def]
    """Fills the normal equations H (K, 6, 6), b (K', 6) of the points' distances to the map: their sums, and with K > 1 the moments too.

    Returns the sum of the weights, the sum of the weighted squares [m^2], the sum of the weights of the robust kernel alone, the number of
    points near a mapped surface, and the mean distance of all points from the camera [m].
    """
    n = len(distance)
    J, w, residuals, row = np.empty((6, n)), np.empty(n), np.empty(n), np.empty(n)
    total, squares, robustly, known, radius = 0.0, 0.0, 0.0, 0, 0.0
    for i in range(n):
        x, y, z = turned[i, 0], turned[i, 1], turned[i, 2]
        radius += np.sqrt(x * x + y * y + z * z)
        if abs(distance[i]) >= MAPPED * truncation or slope[i] <= LEAST_SLOPE:
            continue
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        r = distance[i] / max(slope[i], SLOPE_FLOOR)
        scale = robust * min(sigma[i], widest)
        kernel = 1 + (r / scale) ** 2
        w[known] = 1 / (kernel * kernel * sigma[i] * sigma[i])
        J[0, known], J[1, known], J[2, known] = nx, ny, nz
        J[3, known], J[4, known], J[5, known] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
        residuals[known], row[known] = r, rows[i]
        total += w[known]
        squares += w[known] * r * r
        robustly += 1 / (kernel * kernel)
        known += 1
    fill_sums(J[:, :known], w[:known], residuals[:known], row[:known], H, b)
    return total, squares, robustly, known, radius / n


@_compiled
def patch_points(depth, jitter, patch, fx, fy, cx, cy, points, sigma, row_of, patches) -> int:  # type: ignore[no-untyped-def]
    """Fills points (N, 3) [m], sigma (N,), row_of (N,) and patches (rows, columns) with a pixel of each patch, if it has depth; returns N.

    jitter (2, rows, columns): row and column of the pixel within its patch.
    """
    rows, columns = patches.shape
    found = 0
    for i in range(rows):
        for j in range(columns):
            v, u = i * patch + jitter[0, i, j], j * patch + jitter[1, i, j]
            d = depth[v, u]
            if d > 0:
                points[found, 0], points[found, 1], points[found, 2] = (np.float32(u) - cx) / fx * d, (np.float32(v) - cy) / fy * d, d
                beyond = max(d - _NEAREST_READING, np.float32(0))
                sigma[found] = np.float32(1) + _GROWTH * beyond * beyond
                row_of[found] = (np.float32(v) + np.float32(0.5)) / np.float32(len(depth)) - np.float32(0.5)
                patches[i, j] = found
                found += 1
            else:
                patches[i, j] = -1
    return found


@_compiled
def carry_points(points, seconds, velocity, out) -> None:  # type: ignore[no-untyped-def]
    """Fills out (N, 3) with points (N, 3), each carried by the velocity (6,) for its seconds (N,)."""
    for n in range(len(points)):
        out[n, 0], out[n, 1], out[n, 2] = carry(points[n, 0], points[n, 1], points[n, 2], seconds[n], velocity)


@_compiled
def place(points, rows, T, times, velocity, turned, world) -> None:  # type: ignore[no-untyped-def]
    """Fills turned (N, 3), points (N, 3) that depth's rows (N,) read, at a pose T (4, 4), from the camera's centre, and world (N, 3).

    times (3,), velocity (6,): as for `numba_landmarks.photometric_system`. They are as at the time stamp.
    """
    R, shift_x, shift_y, shift_z = numbers(T), T[0, 3], T[1, 3], T[2, 3]
    v = velocity[0], velocity[1], velocity[2], velocity[3], velocity[4], velocity[5]
    readout, delay = times[1], times[2]
    for n in range(len(points)):
        x, y, z = along_axes(R, points[n, 0], points[n, 1], points[n, 2])
        x, y, z = carry(x, y, z, delay + readout * rows[n], v)
        turned[n, 0], turned[n, 1], turned[n, 2] = x, y, z
        world[n, 0], world[n, 1], world[n, 2] = x + shift_x, y + shift_y, z + shift_z


@_compiled
def carry_distance(points, asked, distance, gradient, out) -> float:  # type: ignore[no-untyped-def]
    """Fills out (N,) with distances carried along gradients, and returns the sum of squares: `surface_distances._carried_distance`."""
    squares = 0.0
    for n in range(len(points)):
        x, y, z = points[n, 0] - asked[n, 0], points[n, 1] - asked[n, 1], points[n, 2] - asked[n, 2]
        squares += x * x + y * y + z * z
        out[n] = distance[n] + x * gradient[n, 0] + y * gradient[n, 1] + z * gradient[n, 2]
    return squares
