"""Landmarks in an image on the CPU, compiled by Numba: normal equations of their brightness, and their displacement.

The plain forms are in the modules that call these.
"""

import numpy as np
from numba import njit

from idfslam.alignment.constants import DEVIATION, LEAST_GRADIENT, MASKED, NEAREST, OCCLUSION, OCCLUSION_SHARE, ROW_STEPS
from idfslam.alignment.kernels.light import expected_brightness, relit
from idfslam.alignment.kernels.moving_points import along_axes, carry, numbers, row_of
from idfslam.alignment.kernels.normal_equations import fill_sums
from idfslam.alignment.kernels.numba_motion import move
from idfslam.geometry.cholesky import solved

_MASKED = np.float32(MASKED)
_FASTMATH = {"contract", "reassoc", "nsz", "arcp"}
_compiled = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy")
_inlined = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", forceinline=True)  # why: numba_grid


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
def _landmarks_at_rows(points, T_wk, T_wc, times, velocity, fy, cy, height):  # type: ignore[no-untyped-def]
    """Landmarks from the camera's centre along world axes, d (3, M), and along its own axes, camera (3, M), as the rows of colour see them.

    The third result is the latter as the rows of depth see them: `sighting.at_their_rows`.
    """
    m = len(points)
    d, camera = np.empty((3, m)), np.empty((3, m))
    R_wk, R_cw, v = numbers(T_wk), numbers(T_wc[:3, :3].T), (velocity[0], velocity[1], velocity[2], velocity[3], velocity[4], velocity[5])
    shift_x, shift_y, shift_z = T_wk[0, 3] - T_wc[0, 3], T_wk[1, 3] - T_wc[1, 3], T_wk[2, 3] - T_wc[2, 3]
    for i in range(m):
        x, y, z = along_axes(R_wk, points[i, 0], points[i, 1], points[i, 2])
        d[0, i], d[1, i], d[2, i] = x + shift_x, y + shift_y, z + shift_z
        camera[0, i], camera[1, i], camera[2, i] = along_axes(R_cw, d[0, i], d[1, i], d[2, i])
    readout, depth_readout, delay = times[0], times[1], times[2]
    if readout == 0 and depth_readout == 0 and delay == 0:
        return d, camera, camera
    of_depth = np.empty((3, m))
    for i in range(m):
        X, Y, Z = d[0, i], d[1, i], d[2, i]
        x, y, z = X, Y, Z
        a, b, c = camera[0, i], camera[1, i], camera[2, i]
        for _ in range(ROW_STEPS):
            x, y, z = carry(X, Y, Z, -readout * row_of(b, c, fy, cy, height), v)
            a, b, c = along_axes(R_cw, x, y, z)
        d[0, i], d[1, i], d[2, i] = x, y, z
        camera[0, i], camera[1, i], camera[2, i] = a, b, c
        x, y, z = carry(X, Y, Z, -(delay + depth_readout * row_of(b, c, fy, cy, height)), v)
        of_depth[0, i], of_depth[1, i], of_depth[2, i] = along_axes(R_cw, x, y, z)
    return d, camera, of_depth


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
def _in_view(  # type: ignore[no-untyped-def]
    points, camera, of_depth, image, fx, fy, cx, cy, depth, ratio_u, ratio_v, without_movers, seen, values, shares
):
    """The number of landmarks that an image (h, w) shows, and of those within it that the frame's depth hides.

    points (M, 3) [m] are in the keyframe's frame, camera and of_depth (3, M) those of `_landmarks_at_rows`. Fills for each landmark in view
    its number in seen (M,), the image's brightness and derivatives there in values (3, M), and in shares (3, M) where it lies: column and
    row of the image, and row of the keyframe [1]. without_movers: a landmark on what moves counts as neither.
    """
    height, width = image.shape
    n, hidden = 0, 0
    for i in range(len(points)):
        x, y, z = camera[0, i], camera[1, i], camera[2, i]
        if z < NEAREST:
            continue
        u, v = x / z * fx + cx, y / z * fy + cy
        if u < 1 or v < 1 or u > width - 2 or v > height - 2:
            continue
        if without_movers and _masked(u, v, depth, ratio_u, ratio_v):
            continue
        if _hidden(of_depth[0, i], of_depth[1, i], of_depth[2, i], depth, ratio_u, ratio_v, fx, fy, cx, cy, width, height):
            hidden += 1
            continue
        seen[n] = i
        values[0, n], values[1, n], values[2, n] = _brightness(image, u, v)
        shares[0, n], shares[1, n] = (u + 0.5) / width, (v + 0.5) / height
        shares[2, n] = row_of(points[i, 1], points[i, 2], fy, cy, height) + 0.5
        n += 1
    return n, hidden


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
    height = len(image)
    d, camera, of_depth = _landmarks_at_rows(points, T_wk, T_wc, times, velocity, fy, cy, height)
    seen, values, shares = np.empty(len(points), np.int64), np.empty((3, len(points))), np.empty((3, len(points)))
    n, _ = _in_view(points, camera, of_depth, image, fx, fy, cx, cy, depth, ratio_u, ratio_v, False, seen, values, shares)
    if n == 0:
        return 0, 0.0
    J, w, r, rows, light = np.empty((6, n)), np.empty(n), np.empty(n), np.empty(n), np.ones(n)
    if even:
        expected_brightness(target[seen[:n]], values[0, :n], light, r)
        r[:] = values[0, :n] - r
    else:
        relit(target[seen[:n]], values[0, :n], values[1:, :n], shares[:, :n], light, r)
    scale = max(DEVIATION * np.median(np.abs(r)), floor)
    R_wc = numbers(T_wc)
    for k in range(n):
        i = seen[k]
        x, y, z = camera[0, i], camera[1, i], camera[2, i]
        per_z = 1 / z
        su, sv = values[1, k] * fx * per_z, values[2, k] * fy * per_z
        a, b_, c = along_axes(R_wc, -su, -sv, (su * x + sv * y) * per_z)
        J[0, k], J[1, k], J[2, k] = a, b_, c
        J[3, k], J[4, k], J[5, k] = d[1, i] * c - d[2, i] * b_, d[2, i] * a - d[0, i] * c, d[0, i] * b_ - d[1, i] * a
        kernel = 1 + (r[k] / (widest * scale)) ** 2
        w[k] = 1 / (kernel * kernel * scale * scale)
        rows[k] = (y * per_z * fy + cy + 0.5) / height - 0.5
    fill_sums(J, w, r, rows, H, b)
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
    n, hidden = _in_view(points, camera, of_depth, image, fx, fy, cx, cy, depth, ratio_u, ratio_v, True, seen, values, shares)
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
