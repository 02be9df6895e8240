"""The normal equations of a pose on the CPU, compiled by Numba. The plain forms are in the modules that call these.

The alignment of a frame builds them ten times from a few thousand points. In torch the calls would cost more than the arithmetic.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from idfslam.alignment.constants import (
    DEVIATION,
    LEAST_GRADIENT,
    LEAST_RADIUS,
    LEAST_SLOPE,
    LEAST_VALUE,
    MAPPED,
    MASKED,
    NEAREST,
    OCCLUSION,
    OCCLUSION_SHARE,
    ROW_STEPS,
    SLOPE_FLOOR,
)
from idfslam.alignment.kernels.light import expected_brightness, relit
from idfslam.alignment.kernels.numba_motion import move
from idfslam.geometry.cholesky import solved
from idfslam.sensing import depth_noise
from idfslam.sensing.depth_edges import EDGE, EDGE_SHARE

Floats = NDArray[np.float32]

_EDGE, _EDGE_SHARE, _MASKED = np.float32(EDGE), np.float32(EDGE_SHARE), np.float32(MASKED)
_NEAREST_READING, _GROWTH = np.float32(depth_noise.NEAREST), np.float32(depth_noise.GROWTH)
_FASTMATH = {"contract", "reassoc", "nsz", "arcp"}
_compiled = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy")
_inlined = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", forceinline=True)  # why: numba_grid


@_inlined
def _fill_sums(J, w, r, rows, H, b) -> None:  # type: ignore[no-untyped-def]
    """Fills H[0] = sum w J J^T and b[0] = -sum w r J from the columns J (6, N), w (N,), r (N,).

    With moments H[1] and b[1] are the same times `rows` (N,), and H[2] times their squares. Each sum is a loop over columns that lie one
    after another, which the compiler vectorises.
    """
    for i in range(6):
        weighted = w * J[i]
        for j in range(i, 6):
            total, first, second = 0.0, 0.0, 0.0
            if len(H) > 1:
                for k in range(len(w)):
                    product = weighted[k] * J[j, k]
                    total += product
                    first += product * rows[k]
                    second += product * rows[k] * rows[k]
                H[1, i, j], H[1, j, i], H[2, i, j], H[2, j, i] = first, first, second, second
            else:
                for k in range(len(w)):
                    total += weighted[k] * J[j, k]
            H[0, i, j], H[0, j, i] = total, total
        total, first = 0.0, 0.0
        for k in range(len(w)):
            total -= weighted[k] * r[k]
            first -= weighted[k] * r[k] * rows[k]
        b[0, i] = total
        if len(b) > 1:
            b[1, i] = first


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
    _fill_sums(J[:, :known], w[:known], residuals[:known], row[:known], H, b)
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
def count_within(points, normals, offsets) -> int:  # type: ignore[no-untyped-def]
    """The number of points (N, 3) before all planes with normals (K, 3) and offsets (K,): `recent_frame.plain_within`."""
    count = 0
    for n in range(len(points)):
        within = True
        for k in range(len(normals)):
            distance = points[n, 0] * normals[k, 0] + points[n, 1] * normals[k, 1] + points[n, 2] * normals[k, 2] + offsets[k]
            within &= distance > 0
        count += within
    return count


@_compiled
def luminance_of(colour, out) -> None:  # type: ignore[no-untyped-def]
    """Fills out (H, W) with the means of colour (H, W, 3)."""
    channels, means = colour.reshape(-1), out.reshape(-1)  # in one dimension the loop vectorises
    for i in range(len(means)):
        means[i] = (channels[3 * i] + channels[3 * i + 1] + channels[3 * i + 2]) * np.float32(1 / 3)


@_compiled
def sampled(image, uv, out) -> None:  # type: ignore[no-untyped-def]
    """Fills out (3, N) with an image (h, w) and its slopes at pixels (N, 2): `image_pyramid.plain_sampled`."""
    h, w = image.shape
    zero, one = np.float32(0), np.float32(1)
    for n in range(len(uv)):
        u, v = min(max(uv[n, 0], zero), np.float32(w - 1)), min(max(uv[n, 1], zero), np.float32(h - 1))
        left, top = min(int(u), w - 2), min(int(v), h - 2)
        a, c = u - np.float32(left), v - np.float32(top)
        value, along_u, along_v = zero, zero, zero
        for y, share_y in ((top, one - c), (top + 1, c)):
            for x, share_x in ((left, one - a), (left + 1, a)):
                share = share_x * share_y
                value += share * image[y, x]
                if 0 < x < w - 1:
                    along_u += share * (image[y, x + 1] - image[y, x - 1]) / 2
                if 0 < y < h - 1:
                    along_v += share * (image[y + 1, x] - image[y - 1, x]) / 2
        out[0, n], out[1, n], out[2, n] = value, along_u, along_v


@_compiled
def steepest(image, depth, cell, least, u, v) -> int:  # type: ignore[no-untyped-def]
    """Fills u and v with the pixel of the largest gradient in each cell of an image (h, w), if that is above `least` [1/px].

    Returns their number. The pixel and its neighbours have depth (H, W) [m], with no edge between them: `landmarks.plain_steepest`.
    """
    h, w = image.shape
    found = 0
    rows, columns = np.empty(h, np.int64), np.empty(w, np.int64)
    for y in range(h):
        rows[y] = int((np.float32(y) + np.float32(0.5)) * np.float32(depth.shape[0]) / np.float32(h))
    for x in range(w):
        columns[x] = int((np.float32(x) + np.float32(0.5)) * np.float32(depth.shape[1]) / np.float32(w))
    for top in range(0, h // cell * cell, cell):
        for left in range(0, w // cell * cell, cell):
            best, best_x, best_y = least * least, -1, -1
            for y in range(top, top + cell):
                for x in range(left, left + cell):
                    a = (image[y, x + 1] - image[y, x - 1]) / 2 if 0 < x < w - 1 else np.float32(0)
                    b = (image[y + 1, x] - image[y - 1, x]) / 2 if 0 < y < h - 1 else np.float32(0)
                    if a * a + b * b > best and _on_one_surface(depth, rows, columns, x, y):
                        best, best_x, best_y = a * a + b * b, x, y
            if best_x >= 0:
                u[found], v[found] = best_x, best_y
                found += 1
    return found


@_inlined
def _on_one_surface(depth, rows, columns, x, y) -> bool:  # type: ignore[no-untyped-def]
    """Whether a pixel and its eight neighbours have depth, and none is much nearer or farther."""
    nearest, farthest = np.float32(np.inf), np.float32(0)
    for j in range(max(y - 1, 0), min(y + 2, len(rows))):
        for i in range(max(x - 1, 0), min(x + 2, len(columns))):
            z = depth[rows[j], columns[i]]
            nearest, farthest = min(nearest, z), max(farthest, z)
    return nearest > 0 and farthest - nearest < _EDGE + _EDGE_SHARE * nearest


@_inlined
def _brightness(image, u, v):  # type: ignore[no-untyped-def]
    """The brightness of an image at a pixel at least one from the border, and its derivatives along u and v [1/px].

    All are bilinear between pixels; there, the derivatives are central differences.
    """
    x, y = min(int(u), image.shape[1] - 3), min(int(v), image.shape[0] - 3)
    a, c = u - x, v - y
    b, d = 1 - a, 1 - c
    above, upper, lower, below = image[y - 1], image[y], image[y + 1], image[y + 2]
    upper_middle, lower_middle = upper[x] * b + upper[x + 1] * a, lower[x] * b + lower[x + 1] * a
    along_u = (
        ((upper[x + 1] - upper[x - 1]) * b + (upper[x + 2] - upper[x]) * a) * d
        + ((lower[x + 1] - lower[x - 1]) * b + (lower[x + 2] - lower[x]) * a) * c
    ) / 2
    along_v = ((lower_middle - (above[x] * b + above[x + 1] * a)) * d + ((below[x] * b + below[x + 1] * a) - upper_middle) * c) / 2
    return upper_middle * d + lower_middle * c, along_u, along_v


@_inlined
def _carry(x, y, z, s, velocity):  # type: ignore[no-untyped-def]
    """A point carried by a velocity (6,) for s seconds: exp(s velocity) p to second order, as `frame_motion.plain_carried` has it."""
    wx, wy, wz = velocity[3], velocity[4], velocity[5]
    a, b, c = wy * z - wz * y + velocity[0], wz * x - wx * z + velocity[1], wx * y - wy * x + velocity[2]
    half = s * s / 2
    return x + s * a + half * (wy * c - wz * b), y + s * b + half * (wz * a - wx * c), z + s * c + half * (wx * b - wy * a)


@_compiled
def carry_points(points, seconds, velocity, out) -> None:  # type: ignore[no-untyped-def]
    """Fills out (N, 3) with points (N, 3), each carried by the velocity (6,) for its seconds (N,)."""
    for n in range(len(points)):
        out[n, 0], out[n, 1], out[n, 2] = _carry(points[n, 0], points[n, 1], points[n, 2], seconds[n], velocity)


@_inlined
def _numbers(R):  # type: ignore[no-untyped-def]
    """The numbers of R (3, 3), row by row. Unlike those of an array, a loop that fills arrays need not read them again at each step."""
    return R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2]


@_inlined
def _along_axes(R, x, y, z):  # type: ignore[no-untyped-def]
    """A matrix of numbers R times a point."""
    return R[0] * x + R[1] * y + R[2] * z, R[3] * x + R[4] * y + R[5] * z, R[6] * x + R[7] * y + R[8] * z


@_compiled
def place(points, rows, T, times, velocity, turned, world) -> None:  # type: ignore[no-untyped-def]
    """Fills turned (N, 3), points (N, 3) that depth's rows (N,) read, at a pose T (4, 4), from the camera's centre, and world (N, 3).

    times (3,), velocity (6,): as for `photometric_system`. They are as at the time stamp.
    """
    R, shift_x, shift_y, shift_z = _numbers(T), T[0, 3], T[1, 3], T[2, 3]
    v = velocity[0], velocity[1], velocity[2], velocity[3], velocity[4], velocity[5]
    readout, delay = times[1], times[2]
    for n in range(len(points)):
        x, y, z = _along_axes(R, points[n, 0], points[n, 1], points[n, 2])
        x, y, z = _carry(x, y, z, delay + readout * rows[n], v)
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


@_inlined
def _landmarks_at_rows(points, T_wk, T_wc, times, velocity, fy, cy, height):  # type: ignore[no-untyped-def]
    """Landmarks from the camera's centre along world axes, d (3, M), and along its own axes, camera (3, M), as the rows of colour see them.

    The third result is the latter as the rows of depth see them: `sighting.at_their_rows`.
    """
    m = len(points)
    d, camera = np.empty((3, m)), np.empty((3, m))
    R_wk, R_cw, v = _numbers(T_wk), _numbers(T_wc[:3, :3].T), (velocity[0], velocity[1], velocity[2], velocity[3], velocity[4], velocity[5])
    shift_x, shift_y, shift_z = T_wk[0, 3] - T_wc[0, 3], T_wk[1, 3] - T_wc[1, 3], T_wk[2, 3] - T_wc[2, 3]
    for i in range(m):
        x, y, z = _along_axes(R_wk, points[i, 0], points[i, 1], points[i, 2])
        d[0, i], d[1, i], d[2, i] = x + shift_x, y + shift_y, z + shift_z
        camera[0, i], camera[1, i], camera[2, i] = _along_axes(R_cw, d[0, i], d[1, i], d[2, i])
    readout, depth_readout, delay = times[0], times[1], times[2]
    if readout == 0 and depth_readout == 0 and delay == 0:
        return d, camera, camera
    of_depth = np.empty((3, m))
    for i in range(m):
        X, Y, Z = d[0, i], d[1, i], d[2, i]
        x, y, z = X, Y, Z
        a, b, c = camera[0, i], camera[1, i], camera[2, i]
        for _ in range(ROW_STEPS):
            x, y, z = _carry(X, Y, Z, -readout * _row(b, c, fy, cy, height), v)
            a, b, c = _along_axes(R_cw, x, y, z)
        d[0, i], d[1, i], d[2, i] = x, y, z
        camera[0, i], camera[1, i], camera[2, i] = a, b, c
        x, y, z = _carry(X, Y, Z, -(delay + depth_readout * _row(b, c, fy, cy, height)), v)
        of_depth[0, i], of_depth[1, i], of_depth[2, i] = _along_axes(R_cw, x, y, z)
    return d, camera, of_depth


@_inlined
def _row(y, z, fy, cy, height):  # type: ignore[no-untyped-def]
    """The row that sees a point, from -0.5 at the top of the image to 0.5 at its bottom."""
    return min(max((y / max(z, NEAREST) * fy + cy + 0.5) / height, 0.0), 1.0) - 0.5


@_inlined
def _hidden(x, y, z, depth, ratio_u, ratio_v, fx, fy, cx, cy, width, height):  # type: ignore[no-untyped-def]
    """Whether the frame's depth contradicts a point: something is in front of it, or there is nothing."""
    z = max(z, NEAREST)
    u, v = min(max(x / z * fx + cx, 0.0), width - 1.0), min(max(y / z * fy + cy, 0.0), height - 1.0)
    measured = depth[int((v + 0.5) * ratio_v), int((u + 0.5) * ratio_u)]
    return measured > 0 and abs(measured - z) >= OCCLUSION + OCCLUSION_SHARE * z


@_inlined
def _masked(u, v, depth, ratio_u, ratio_v):  # type: ignore[no-untyped-def]
    """Whether a pixel of an image shows what moves, by the frame's depth (H, W), which has `ratio` times as many pixels along each axis."""
    measured = depth[int((v + 0.5) * ratio_v), int((u + 0.5) * ratio_u)]
    return measured > 0 and measured <= _MASKED


@_inlined
def photometric_system(  # type: ignore[no-untyped-def]
    points, target, T_wk, T_wc, times, velocity, image, fx, fy, cx, cy, depth, ratio_u, ratio_v, floor, widest, even, H, b
):
    """Fills the normal equations of the brightness differences of landmarks (M, 3) [m], keyframe axes, in an image (h, w).

    H (K, 6, 6), b (K', 6): sums, and with K > 1 moments of the rows too. Returns the number of landmarks in view and the scale of the
    differences: `photometric.photometric_term`.

    T_wk, T_wc (4, 4): the poses of the keyframe and of the frame. `depth` (H, W) [m] is the frame's. It has `ratio` times as many pixels
    along each axis as the image. times (3,) [s]: read-out of colour and of depth, and delay of depth; velocity (6,): with them, landmarks
    are seen where the camera is when their rows are read. even: whether light has changed everywhere alike.
    """
    height, width = image.shape
    d, camera, of_depth = _landmarks_at_rows(points, T_wk, T_wc, times, velocity, fy, cy, height)
    seen, values, shares, n = np.empty(len(points), np.int64), np.empty((3, len(points))), np.empty((3, len(points))), 0
    for i in range(len(points)):
        x, y, z = camera[0, i], camera[1, i], camera[2, i]
        if z < NEAREST:
            continue
        u, v = x / z * fx + cx, y / z * fy + cy
        if u < 1 or v < 1 or u > width - 2 or v > height - 2:
            continue
        if _hidden(of_depth[0, i], of_depth[1, i], of_depth[2, i], depth, ratio_u, ratio_v, fx, fy, cx, cy, width, height):
            continue
        seen[n] = i
        values[0, n], values[1, n], values[2, n] = _brightness(image, u, v)
        shares[0, n], shares[1, n] = (u + 0.5) / width, (v + 0.5) / height
        shares[2, n] = _row(points[i, 1], points[i, 2], fy, cy, height) + 0.5
        n += 1
    if n == 0:
        return 0, 0.0
    J, w, r, rows, light = np.empty((6, n)), np.empty(n), np.empty(n), np.empty(n), np.ones(n)
    if even:
        expected_brightness(target[seen[:n]], values[0, :n], light, r)
        r[:] = values[0, :n] - r
    else:
        relit(target[seen[:n]], values[0, :n], values[1:, :n], shares[:, :n], light, r)
    scale = max(DEVIATION * np.median(np.abs(r)), floor)
    R_wc = _numbers(T_wc)
    for k in range(n):
        i = seen[k]
        x, y, z = camera[0, i], camera[1, i], camera[2, i]
        per_z = 1 / z
        su, sv = values[1, k] * fx * per_z, values[2, k] * fy * per_z
        a, b_, c = _along_axes(R_wc, -su, -sv, (su * x + sv * y) * per_z)
        J[0, k], J[1, k], J[2, k] = a, b_, c
        J[3, k], J[4, k], J[5, k] = d[1, i] * c - d[2, i] * b_, d[2, i] * a - d[0, i] * c, d[0, i] * b_ - d[1, i] * a
        kernel = 1 + (r[k] / (widest * scale)) ** 2
        w[k] = 1 / (kernel * kernel * scale * scale)
        rows[k] = (y * per_z * fy + cy + 0.5) / height - 0.5
    _fill_sums(J, w, r, rows, H, b)
    return n, scale


@_compiled
def photometric_systems(  # type: ignore[no-untyped-def]
    points, target, starts, T_wk, T_wc, times, velocity, image, fx, fy, cx, cy, depth, ratio_u, ratio_v, floor, widest, factor, H, b
):
    """Fills H (N, K, 6, 6), b (N, K', 6) with the equations of N keyframes at T_wk (N, 4, 4), times a factor: `image_term.plain_terms`.

    Returns the numbers of landmarks in view (N,) and the scales of the differences (N,). starts (N + 1,): where the landmarks of each
    keyframe begin in points (M, 3) and target (M,). All else is as for `photometric_system`.
    """
    seen, noise = np.empty(len(T_wk), np.int64), np.empty(len(T_wk))
    for k in range(len(T_wk)):
        marks = slice(starts[k], starts[k + 1])
        H[k], b[k] = 0.0, 0.0
        seen[k], noise[k] = photometric_system(
            points[marks], target[marks], T_wk[k], T_wc, times, velocity,
            image, fx, fy, cx, cy, depth, ratio_u, ratio_v, floor, widest, False, H[k], b[k],
        )  # fmt: skip
        H[k] *= factor
        b[k] *= factor
    return seen, noise


@_compiled
def turn_on_level(  # type: ignore[no-untyped-def]
    points, target, T_wk, T_wc, image, fx, fy, cx, cy, depth, ratio_u, ratio_v, floor, widest, even, share, deviation, steps, converged
) -> None:
    """Turns a pose T_wc (4, 4) in place by Gauss-Newton steps: `image_rotation.plain_turned_on_level`.

    share [1]: of the landmarks that err independently. deviation [rad]: of the prior at each step's pose. All else is as for
    `photometric_system`.
    """
    H, b, change, still = np.empty((1, 6, 6)), np.empty((1, 6)), np.zeros(6), np.zeros(6)
    for _ in range(steps):
        H[:], b[:] = 0.0, 0.0
        photometric_system(
            points, target, T_wk, T_wc, still[:3], still, image, fx, fy, cx, cy, depth, ratio_u, ratio_v, floor, widest, even, H, b
        )
        change[3:] = solved(share * H[0, 3:, 3:] + np.eye(3) / deviation**2, share * b[0, 3:])
        move(T_wc, change, T_wc)
        if np.abs(change).max() < converged:
            break


@_compiled
def median_displacement(  # type: ignore[no-untyped-def]
    points, target, slopes, T_wk, T_wc, times, velocity, image, fx, fy, cx, cy, depth, ratio_u, ratio_v
):
    """The number of landmarks (M, 3) [m] within an image (h, w), and their median displacement [px]: `displacement.plain_displacement`.

    slopes (2, M): the derivatives of the keyframe's brightness. All else is as for `photometric_system`.
    """
    height, width = image.shape
    _, camera, of_depth = _landmarks_at_rows(points, T_wk, T_wc, times, velocity, fy, cy, height)
    seen, values, shares = np.empty(len(points), np.int64), np.empty((3, len(points))), np.empty((3, len(points)))
    n, hidden = 0, 0
    for i in range(len(points)):
        x, y, z = camera[0, i], camera[1, i], camera[2, i]
        if z < NEAREST:
            continue
        u, v = x / z * fx + cx, y / z * fy + cy
        if u < 1 or v < 1 or u > width - 2 or v > height - 2:
            continue
        if _masked(u, v, depth, ratio_u, ratio_v):
            continue
        if _hidden(of_depth[0, i], of_depth[1, i], of_depth[2, i], depth, ratio_u, ratio_v, fx, fy, cx, cy, width, height):
            hidden += 1
            continue
        seen[n] = i
        values[0, n], values[1, n], values[2, n] = _brightness(image, u, v)
        shares[0, n], shares[1, n] = (u + 0.5) / width, (v + 0.5) / height
        shares[2, n] = _row(points[i, 1], points[i, 2], fy, cy, height) + 0.5
        n += 1
    if n + hidden == 0:
        return 0, 0.0
    displaced = np.full(n + hidden, np.float64(width))
    if n > 0:
        light, r, means = np.empty(n), np.empty(n), np.empty((2, n))
        for k in range(n):
            means[0, k], means[1, k] = (values[1, k] + slopes[0, seen[k]]) / 2, (values[2, k] + slopes[1, seen[k]]) / 2
        gain = relit(target[seen[:n]], values[0, :n], means, shares[:, :n], light, r)
        for k in range(n):
            of_keyframe = gain * light[k]
            du, dv = (values[1, k] + of_keyframe * slopes[0, seen[k]]) / 2, (values[2, k] + of_keyframe * slopes[1, seen[k]]) / 2
            displaced[k] = min(abs(r[k]) / max(np.sqrt(du * du + dv * dv), LEAST_GRADIENT), np.float64(width))
    return n + hidden, np.median(displaced)


@_compiled
def joint_step(depth_H, depth_b, image_H, image_b, times, information, scale, from_prior, delta) -> None:  # type: ignore[no-untyped-def]
    """Fills delta (18,), the change of pose, velocity and the references' error of velocity: `gauss_newton.joint_step`.

    Velocity and references' error act alike on the residuals, so that their rows and columns are the same.
    """
    readout, depth_readout, delay = times
    left, right = information.copy(), np.empty(18)
    for i in range(18):
        k = i % 6
        by_velocity = i >= 6
        if by_velocity:
            right[i] = scale * (delay * depth_b[0, k] + depth_readout * depth_b[1, k] + readout * image_b[1, k])
        else:
            right[i] = scale * (depth_b[0, k] + image_b[0, k])
        for j in range(18):
            m = j % 6
            if by_velocity and j >= 6:
                h = delay * (delay * depth_H[0, k, m] + 2 * depth_readout * depth_H[1, k, m])
                h += depth_readout * depth_readout * depth_H[2, k, m] + readout * readout * image_H[2, k, m]
            elif by_velocity or j >= 6:
                h = delay * depth_H[0, k, m] + depth_readout * depth_H[1, k, m] + readout * image_H[1, k, m]
            else:
                h = depth_H[0, k, m] + image_H[0, k, m]
            left[i, j] += scale * h
            right[i] -= information[i, j] * from_prior[j]
            if j >= 12:
                right[i] -= scale * h * from_prior[j]
    delta[:] = solved(left, right)


@_compiled
def damped_step(H, b, weight, radius, prior_information, change, T) -> float:  # type: ignore[no-untyped-def]
    """A Gauss-Newton step of normal equations H (6, 6), b (6,) with a prior at the guess: `gauss_newton.plain_damped_step`.

    Moves in place the pose T (4, 4) and its change since the guess, change (6,). Returns the largest entry of the step.
    """
    unit = np.ones(6)
    unit[3:] = 1 / max(radius, LEAST_RADIUS)
    scaled = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            scaled[i, j] = H[i, j] * unit[i] * unit[j] / max(weight, 1e-9)
    values, directions = np.linalg.eigh(scaled)
    held = np.empty(6)
    for i in range(6):
        held[i] = max(weight, 1e-9) * prior_information**4 / max(values[i], LEAST_VALUE * prior_information) ** 3
    left, right = np.empty((6, 6)), b.copy()
    for i in range(6):
        for j in range(6):
            prior = 0.0
            for k in range(6):
                prior += directions[i, k] * held[k] * directions[j, k]
            prior /= unit[i] * unit[j]
            left[i, j] = H[i, j] + prior
            right[i] -= prior * change[j]
    delta = solved(left, right)
    change += delta
    move(T, delta, T)
    return np.abs(delta).max()
