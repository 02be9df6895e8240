"""The inner loop of `tracking/patch_alignment.py` on the CPU, compiled by Numba. The plain form is there."""

from typing import Any

import numpy as np
from numba import njit

_FASTMATH = {"nnan", "nsz", "reassoc", "contract", "arcp"}
_compiled: Any = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy")
_inlined: Any = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", forceinline=True)  # why: numba_grid


@_inlined
def _normalise(values) -> np.float32:  # type: ignore[no-untyped-def]
    """Subtracts the mean of values (N,) and divides by their norm, in place. Returns the norm."""
    mean, square = np.float32(0), np.float32(0)
    for k in range(len(values)):
        mean += values[k]
    mean /= len(values)
    for k in range(len(values)):
        values[k] -= mean
        square += values[k] * values[k]
    norm = np.sqrt(square)
    if norm > 0:
        for k in range(len(values)):
            values[k] /= norm
    return norm


@_inlined
def _cut_out(image, u, v, warp, patch) -> bool:  # type: ignore[no-untyped-def]
    """Fills a patch (n, n) with the image's values around (u, v), warped; False if it reaches out of the image."""
    rows, columns = image.shape
    half = len(patch) // 2
    a, b, c, d = warp[0, 0], warp[0, 1], warp[1, 0], warp[1, 1]
    reach_x, reach_y = half * (abs(a) + abs(b)), half * (abs(c) + abs(d))
    if not (u >= reach_x and u + reach_x < columns - 1 and v >= reach_y and v + reach_y < rows - 1):
        return False
    for i in range(len(patch)):
        for j in range(len(patch)):
            x = u + a * (j - half) + b * (i - half)
            y = v + c * (j - half) + d * (i - half)
            column, row = int(x), int(y)
            p, q = np.float32(x - column), np.float32(y - row)
            top = image[row, column] * (1 - p) + image[row, column + 1] * p
            bottom = image[row + 1, column] * (1 - p) + image[row + 1, column + 1] * p
            patch[i, j] = top * (1 - q) + bottom * q
    return True


@_inlined
def _sampled(image, x, y, values) -> bool:  # type: ignore[no-untyped-def]
    """Fills values (n * n,) with the image's values around (x, y); False if they reach out of the image."""
    side = int(np.sqrt(len(values)))
    column, row = int(np.floor(x)) - side // 2, int(np.floor(y)) - side // 2
    if column < 0 or row < 0 or column + side >= image.shape[1] or row + side >= image.shape[0]:
        return False
    p, q = np.float32(x - np.floor(x)), np.float32(y - np.floor(y))
    w00, w01, w10, w11 = (1 - p) * (1 - q), p * (1 - q), (1 - p) * q, p * q
    for i in range(side):
        for j in range(side):
            r, m = row + i, column + j
            values[i * side + j] = w00 * image[r, m] + w01 * image[r, m + 1] + w10 * image[r + 1, m] + w11 * image[r + 1, m + 1]
    return True


@_inlined
def _gradients(patch, t, contrast, gx, gy) -> None:  # type: ignore[no-untyped-def]
    """Fills gx, gy (n * n,) with the gradients of a patch (n + 2, n + 2), whose normalised form is t (n * n,), divided by its contrast.

    A change of brightness or contrast is no motion: the gradients' parts along 1 and t are left out.
    """
    side = len(patch) - 2
    mx, my, tx, ty = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
    for i in range(side):
        for j in range(side):
            k = i * side + j
            gx[k] = (patch[i + 1, j + 2] - patch[i + 1, j]) / 2
            gy[k] = (patch[i + 2, j + 1] - patch[i, j + 1]) / 2
            mx += gx[k]
            my += gy[k]
            tx += gx[k] * t[k]
            ty += gy[k] * t[k]
    mx /= len(t)
    my /= len(t)
    for k in range(len(t)):
        gx[k] = (gx[k] - mx - tx * t[k]) / contrast
        gy[k] = (gy[k] - my - ty * t[k]) / contrast


@_inlined
def _search(image, t, gx, gy, h, start, iterations, max_shift, converged, s):  # type: ignore[no-untyped-def]
    """x, y where a patch with gradients gx, gy and Hessian h lies in an image, and its correlation there; -1 if it was not found."""
    hxx, hxy, hyy = h
    determinant = hxx * hyy - hxy * hxy
    x, y = start
    for step in range(iterations + 1):
        if not _sampled(image, x, y, s) or _normalise(s) == 0:
            break
        bx, by, square = np.float32(0), np.float32(0), np.float32(0)
        for k in range(len(t)):
            e = s[k] - t[k]
            bx += gx[k] * e
            by += gy[k] * e
            square += e * e
        dx, dy = (hyy * bx - hxy * by) / determinant, (hxx * by - hxy * bx) / determinant
        if step == iterations:
            return x, y, 1 - square / 2
        x -= dx
        y -= dy
        if abs(x - start[0]) > max_shift or abs(y - start[1]) > max_shift:
            break
        if dx * dx + dy * dy < converged * converged:
            return x, y, 1 - square / 2
    return x, y, np.float32(-1)


@_compiled
def align_patches(image, to_image, uv, warp, start, half, iterations, limits, found, H, correlation):  # type: ignore[no-untyped-def]
    """Fills found (N, 2), H (N, 3), correlation (N,): where each patch of `image` lies in `to_image`; correlation -1: nowhere.

    Both images are (h, w) uint8. Patch n has its centre at uv[n] of the first. Its point at the offset warp[n] @ d from the centre lies at
    the offset d from the centre in the second, which is searched from start[n] on. limits: largest shift, least contrast, least texture,
    shift at convergence.
    """
    max_shift, min_contrast, least_texture, converged = limits
    side = 2 * half + 1
    patch = np.empty((side + 2, side + 2), np.float32)
    t, s = np.empty(side * side, np.float32), np.empty(side * side, np.float32)
    gx, gy = np.empty_like(t), np.empty_like(t)
    for n in range(len(uv)):
        correlation[n] = -1
        if not _cut_out(image, uv[n, 0], uv[n, 1], warp[n], patch):
            continue
        for i in range(side):
            t[i * side : (i + 1) * side] = patch[i + 1, 1:-1]
        contrast = _normalise(t)
        if contrast < min_contrast * side:
            continue
        _gradients(patch, t, contrast, gx, gy)
        H[n, 0], H[n, 1], H[n, 2] = (gx * gx).sum(), (gx * gy).sum(), (gy * gy).sum()
        if H[n, 0] * H[n, 2] - H[n, 1] * H[n, 1] > least_texture * (H[n, 0] + H[n, 2]) ** 2:
            h, from_uv = (H[n, 0], H[n, 1], H[n, 2]), (start[n, 0], start[n, 1])
            found[n, 0], found[n, 1], correlation[n] = _search(to_image, t, gx, gy, h, from_uv, iterations, max_shift, converged, s)


@_compiled
def projection_system(T_ck, points, uv, information, depth, depth_information, camera, scale, H, b):  # type: ignore[no-untyped-def]
    """Adds to H (6, 6), b (6,) the differences of uv (N, 2) and depth (N,) to the projections of the points (N, 3) at T_ck (4, 4).

    information (N, 2, 2) of uv, depth_information (N,). camera: fx, fy, cx, cy. scale: of the robust weights [standard deviations].
    """
    fx, fy, cx, cy = camera
    J = np.empty((3, 6))
    for n in range(len(points)):
        p = points[n]
        x = T_ck[0, 0] * p[0] + T_ck[0, 1] * p[1] + T_ck[0, 2] * p[2] + T_ck[0, 3]
        y = T_ck[1, 0] * p[0] + T_ck[1, 1] * p[1] + T_ck[1, 2] * p[2] + T_ck[1, 3]
        z = T_ck[2, 0] * p[0] + T_ck[2, 1] * p[1] + T_ck[2, 2] * p[2] + T_ck[2, 3]
        if z <= 0:
            continue
        du, dv = fx * x / z + cx - uv[n, 0], fy * y / z + cy - uv[n, 1]
        a, c, d = information[n, 0, 0], information[n, 0, 1], information[n, 1, 1]
        square = a * du * du + 2 * c * du * dv + d * dv * dv
        root = 1 / (1 + square / (scale * scale))
        weight = root * root
        for axis in range(3):
            J[0, axis] = -(fx / z * T_ck[0, axis] - fx * x / (z * z) * T_ck[2, axis])
            J[1, axis] = -(fy / z * T_ck[1, axis] - fy * y / (z * z) * T_ck[2, axis])
            J[2, axis] = -T_ck[2, axis]
        dz = z - depth[n]
        root = 1 / (1 + depth_information[n] * dz * dz / (scale * scale))
        weight_z = depth_information[n] * root * root
        for row in range(3):  # the turn moves a point by omega x p
            v0, v1, v2 = J[row, 0], J[row, 1], J[row, 2]
            J[row, 3], J[row, 4], J[row, 5] = p[1] * v2 - p[2] * v1, p[2] * v0 - p[0] * v2, p[0] * v1 - p[1] * v0
        for i in range(6):
            u_i, v_i = a * J[0, i] + c * J[1, i], c * J[0, i] + d * J[1, i]
            b[i] -= weight * (u_i * du + v_i * dv) + weight_z * J[2, i] * dz
            for j in range(i, 6):
                H[i, j] += weight * (u_i * J[0, j] + v_i * J[1, j]) + weight_z * J[2, i] * J[2, j]
    for i in range(6):
        for j in range(i):
            H[i, j] = H[j, i]
