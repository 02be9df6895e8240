"""The integration of depth images into blocks of voxels, on the CPU, compiled by Numba. `integration` has the plain form."""

import numpy as np
from numba import njit, prange

from idfslam.fusion.constants import BLOCK, EDGE_SHARE, ENOUGH, FREE, NEAREST, TILE

_FASTMATH = {"contract", "nsz", "arcp"}
_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
_NEAREST, _EDGE_SHARE = np.float32(NEAREST), np.float32(EDGE_SHARE)
_FREE = np.float32(FREE)
_ROUNDING = np.float32(1e-4)  # [1] share of a depth by which its float32 arithmetic is off at most. A bound. More: slower

_inlined = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", forceinline=True)


@_inlined
def _may_change(x, y, z, radius, T_cw, intrinsics, shape, deepest):  # type: ignore[no-untyped-def]
    """Whether an image may change voxels within `radius` [m] of a point: it shows them, and they are not too far behind what it reads."""
    fx, fy, cx, cy = intrinsics
    height, width = shape
    z_c = T_cw[2, 0] * x + T_cw[2, 1] * y + T_cw[2, 2] * z + T_cw[2, 3]
    if z_c <= _TWO * radius:
        return z_c + radius > _NEAREST
    reach = radius / (z_c - radius)  # the voxels are within a disc in the image
    u = (T_cw[0, 0] * x + T_cw[0, 1] * y + T_cw[0, 2] * z + T_cw[0, 3]) / z_c * fx + cx
    v = (T_cw[1, 0] * x + T_cw[1, 1] * y + T_cw[1, 2] * z + T_cw[1, 3]) / z_c * fy + cy
    in_u, in_v = reach * (fx + abs(u - cx)) + _ONE, reach * (fy + abs(v - cy)) + _ONE
    if u + in_u < _ZERO or u - in_u > width - 1 or v + in_v < _ZERO or v - in_v > height - 1:
        return False
    for row in range(np.int64(max(v - in_v, _ZERO)) // TILE, np.int64(min(v + in_v, height - _ONE)) // TILE + 1):
        for column in range(np.int64(max(u - in_u, _ZERO)) // TILE, np.int64(min(u + in_u, width - _ONE)) // TILE + 1):
            if z_c - radius <= deepest[row, column]:
                return True
    return False


@njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy")
def fill_deepest(depth, slope, information, truncation, deepest):  # type: ignore[no-untyped-def]
    """Raises deepest (h, w) [m] to the depth up to which the readings of each tile of TILE x TILE pixels change voxels."""
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            if information[row, column] > _ZERO:
                deep = _deep(depth[row, column]) + truncation / slope[row, column]
                deepest[row // TILE, column // TILE] = max(deepest[row // TILE, column // TILE], deep)


@_inlined
def _deep(read):  # type: ignore[no-untyped-def]
    """More than any depth [m] interpolated between a reading and others of its surface, and than what rounding adds."""
    return (_ONE + _EDGE_SHARE) * (_ONE + _ROUNDING) * read


@_inlined
def _interpolated(depth, u, v, read):  # type: ignore[no-untyped-def]
    """Depth [m] at pixel u, v between four readings of one surface; elsewhere the nearest one, `read`."""
    left, top = np.int64(np.floor(u)), np.int64(np.floor(v))
    if left < 0 or left >= depth.shape[1] - 1 or top < 0 or top >= depth.shape[0] - 1:
        return read
    a, b, c, d = depth[top, left], depth[top, left + 1], depth[top + 1, left], depth[top + 1, left + 1]
    low, high = min(min(a, b), min(c, d)), max(max(a, b), max(c, d))
    if low <= _ZERO or high - low >= _EDGE_SHARE * read:
        return read
    s, t = u - np.float32(left), v - np.float32(top)
    return _ONE / ((_ONE - t) * ((_ONE - s) / a + s / b) + t * ((_ONE - s) / c + s / d))  # a plane's inverse depth is linear in the image


@njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", parallel=True)
def integrate(  # type: ignore[no-untyped-def]
    origins, voxel, truncation, T_cw, intrinsics, depth, slope, information, deepest, distance, weight, scatter, readings
):
    """Adds one depth image to `distance` and `weight` (M, BLOCK, BLOCK, BLOCK) of blocks with first voxels at `origins` (M, 3) [m].

    All numbers are float32. T_cw (3, 4). depth, slope, information (H, W): as `PreparedDepth` has them. deepest (h, w):
    of `fill_deepest`.
    scatter (M, 2): the sum of squared deviations over their expected variance, and their number, of voxels near the surface. readings (M,):
    number of readings of all voxels; a block with enough of them is left as it is.
    """
    fx, fy, cx, cy = intrinsics
    height, width = depth.shape
    half = np.float32((BLOCK - 1) / 2) * voxel
    radius = half * np.float32(np.sqrt(3.0))
    for m in prange(len(origins)):
        x0, y0, z0 = origins[m]
        if readings[m] >= ENOUGH * BLOCK**3 or not _may_change(
            x0 + half, y0 + half, z0 + half, radius, T_cw, intrinsics, depth.shape, deepest
        ):
            continue
        squares, number, added = _ZERO, _ZERO, 0
        for column in range(BLOCK * BLOCK):  # of voxels along z
            i, j = column // BLOCK, column % BLOCK
            x, y = x0 + np.float32(i) * voxel, y0 + np.float32(j) * voxel
            p = T_cw[0, 0] * x + T_cw[0, 1] * y + T_cw[0, 3]
            q = T_cw[1, 0] * x + T_cw[1, 1] * y + T_cw[1, 3]
            r = T_cw[2, 0] * x + T_cw[2, 1] * y + T_cw[2, 3]
            for k in range(BLOCK):
                z = z0 + np.float32(k) * voxel
                ahead = r + T_cw[2, 2] * z
                inverse = _ONE / max(ahead, _NEAREST)
                u, v = (p + T_cw[0, 2] * z) * inverse * fx + cx, (q + T_cw[1, 2] * z) * inverse * fy + cy
                if ahead <= _NEAREST or not (-_HALF <= u < width - _HALF and -_HALF <= v < height - _HALF):
                    continue
                at = np.int64(v + _HALF), np.int64(u + _HALF)
                read = depth[at]
                if information[at] <= _ZERO or (_deep(read) - ahead) * slope[at] <= -truncation:  # most lie behind; the rest takes longer
                    continue
                to_plane = (read - ahead) * slope[at]
                if to_plane < _TWO * truncation:
                    to_plane = (_interpolated(depth, u, v, read) - ahead) * slope[at]
                place = to_plane / truncation
                if place <= -_ONE:
                    continue
                w = information[at] * min(min(_ONE, _ONE + place), max(_FREE, _TWO - _TWO * place))
                before, off = weight[m, i, j, k], min(to_plane, truncation) - distance[m, i, j, k]
                if before > _ZERO and abs(to_plane) < _HALF * truncation:
                    squares += off * off * (w * before / (w + before))  # as much as they grow (Welford, Technometrics 1962)
                    number += _ONE
                distance[m, i, j, k] += off * (w / (w + before))
                weight[m, i, j, k] = w + before
                added += 1
        scatter[m, 0] += squares
        scatter[m, 1] += number
        readings[m] += added
