"""The integration of depth images into blocks of voxels, on the CPU, compiled by Numba. `integration` has the plain form."""

import numpy as np
from numba import njit, prange

from idfslam.fusion.constants import BLOCK, EDGE_SHARE, ENOUGH, FREE, NEAREST, TILE
from idfslam.sensing.depth_noise import GROWTH
from idfslam.sensing.depth_noise import NEAREST as SHARPEST

_FASTMATH = {"contract", "nsz", "arcp"}
_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
_NEAREST, _EDGE_SHARE = np.float32(NEAREST), np.float32(EDGE_SHARE)
_FREE, _GROWTH, _SHARPEST = np.float32(FREE), np.float32(GROWTH), np.float32(SHARPEST)
_ROUNDING = 1e-4  # [1] share of a depth by which its float32 arithmetic is off at most. A bound. More: slower
_DEEPER = np.float32((1 + _ROUNDING) / (1 - EDGE_SHARE))  # [1] bound of a depth interpolated on a surface over a reading there, likewise

_inlined = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", forceinline=True)


@_inlined
def _may_change(x, y, z, radius, intrinsics, shape, deepest):  # type: ignore[no-untyped-def]
    """Whether an image may change voxels within `radius` [m] of a point in the camera's frame: it shows some, none too far behind."""
    fx, fy, cx, cy = intrinsics
    height, width = shape
    if z <= _TWO * radius:
        return z + radius > _NEAREST
    reach = radius / (z - radius)  # the voxels are within a disc in the image
    u, v = x / z * fx + cx, y / z * fy + cy
    in_u, in_v = reach * (fx + abs(u - cx)) + _ONE, reach * (fy + abs(v - cy)) + _ONE
    if u + in_u < _ZERO or u - in_u > width - 1 or v + in_v < _ZERO or v - in_v > height - 1:
        return False
    for row in range(np.int64(max(v - in_v, _ZERO)) // TILE, np.int64(min(v + in_v, height - _ONE)) // TILE + 1):
        for column in range(np.int64(max(u - in_u, _ZERO)) // TILE, np.int64(min(u + in_u, width - _ONE)) // TILE + 1):
            if z - radius <= deepest[row, column]:
                return True
    return False


@njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy")
def fill_pixels(depth, slope, information, truncation, pixels, deepest):  # type: ignore[no-untyped-def]
    """Fills what voxels need of a pixel, next to each other in memory, and raises `deepest` to the largest depth that a tile changes.

    pixels (H * W + 1, 4): the depth [m] up to which the reading changes voxels, inverse depth [1/m], slope and information; zeros without
    a reading. The last one is for voxels outside of the image. deepest (h, w) [m]: of tiles of TILE x TILE pixels.
    """
    height, width = depth.shape
    pixels[height * width, 0] = -np.inf
    for row in range(height):
        for column in range(width):
            read, at = depth[row, column], row * width + column
            if read > _ZERO:
                pixels[at, 1] = _ONE / read
            if information[row, column] > _ZERO:
                deep = _DEEPER * read + truncation / slope[row, column]
                pixels[at, 0], pixels[at, 2], pixels[at, 3] = deep, slope[row, column], information[row, column]
                deepest[row // TILE, column // TILE] = max(deepest[row // TILE, column // TILE], deep)


@_inlined
def _interpolated(pixels, shape, u, v, read):  # type: ignore[no-untyped-def]
    """Depth [m] at pixel u, v between four readings of one surface; elsewhere the nearest one, `read`."""
    height, width = shape
    left, top = np.int64(np.floor(u)), np.int64(np.floor(v))
    if left < 0 or left >= width - 1 or top < 0 or top >= height - 1:
        return read
    at = top * width + left
    a, b, c, d = pixels[at, 1], pixels[at + 1, 1], pixels[at + width, 1], pixels[at + width + 1, 1]
    low, high = min(min(a, b), min(c, d)), max(max(a, b), max(c, d))
    if low <= _ZERO or (high - low) * read >= _EDGE_SHARE:
        return read
    s, t = u - np.float32(left), v - np.float32(top)
    return _ONE / ((_ONE - t) * ((_ONE - s) * a + s * b) + t * ((_ONE - s) * c + s * d))  # a plane's inverse depth is linear in the image


@_inlined
def _share(place, read, ahead, slope):  # type: ignore[no-untyped-def]
    """Weight over the reading's information, of a voxel at depth `ahead` [m], `place` [truncations] before the surface that is `read`."""
    if place <= _HALF:
        return min(_ONE, _ONE + place)
    ratio = (_ONE + _GROWTH * max(read - _SHARPEST, _ZERO) ** 2) / ((_ONE + _GROWTH * max(ahead - _SHARPEST, _ZERO) ** 2) * slope)
    return min(_ONE, max(_TWO - _TWO * place, _FREE * ratio * ratio))


@_inlined
def _project(first, lattice, intrinsics, shape, ahead, uv, at):  # type: ignore[no-untyped-def]
    """Fills depth (V,) [m], pixels (2, V) and the nearest pixel's place (V,) of a block's voxels: `first` + `lattice` (3, V) [m].

    All of it is in the camera's frame. There is no branch, so that it is computed for several voxels at a time.
    """
    fx, fy, cx, cy = intrinsics
    height, width = shape
    for n in range(BLOCK**3):
        z = first[2] + lattice[2, n]
        inverse = _ONE / max(z, _NEAREST)
        u, v = (first[0] + lattice[0, n]) * inverse * fx + cx, (first[1] + lattice[1, n]) * inverse * fy + cy
        inside = (z > _NEAREST) & (u >= -_HALF) & (u < width - _HALF) & (v >= -_HALF) & (v < height - _HALF)
        place = np.int32(v + _HALF) * width + np.int32(u + _HALF)
        ahead[n], uv[0, n], uv[1, n], at[n] = z, u, v, place if inside else height * width


@njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", parallel=True)
def integrate(  # type: ignore[no-untyped-def]
    origins, lattice, truncation, T_cw, intrinsics, shape, pixels, deepest, distance, weight, scatter, readings
):
    """Adds one depth image to `distance` and `weight` (M, V) of blocks with first voxels at `origins` (M, 3) [m].

    All numbers are float32. T_cw (3, 4). lattice (3, V): a block's voxels in the camera's frame, from its first one [m]. shape: H, W.
    pixels (H * W + 1, 4), deepest (h, w): of `fill_pixels`. scatter (M, 2): the sum of squared deviations over their expected variance,
    and their number, of voxels near the surface. readings (M,): number of readings of all voxels; a block with enough of them is left as
    it is.
    """
    middle = lattice[:, -1] / _TWO
    radius = np.sqrt(middle[0] ** 2 + middle[1] ** 2 + middle[2] ** 2)
    for m in prange(len(origins)):
        if readings[m] >= ENOUGH * BLOCK**3:
            continue
        x, y, z = origins[m, 0], origins[m, 1], origins[m, 2]
        first = (
            T_cw[0, 0] * x + T_cw[0, 1] * y + T_cw[0, 2] * z + T_cw[0, 3],
            T_cw[1, 0] * x + T_cw[1, 1] * y + T_cw[1, 2] * z + T_cw[1, 3],
            T_cw[2, 0] * x + T_cw[2, 1] * y + T_cw[2, 2] * z + T_cw[2, 3],
        )
        if not _may_change(first[0] + middle[0], first[1] + middle[1], first[2] + middle[2], radius, intrinsics, shape, deepest):
            continue
        ahead, uv, at = np.empty(BLOCK**3, np.float32), np.empty((2, BLOCK**3), np.float32), np.empty(BLOCK**3, np.int32)
        _project(first, lattice, intrinsics, shape, ahead, uv, at)
        changed, count = np.empty(BLOCK**3, np.int32), 0
        for n in range(BLOCK**3):  # most lie behind; the rest takes longer
            changed[count] = n
            count += ahead[n] < pixels[at[n], 0]
        squares, number, added = _ZERO, _ZERO, 0
        for n in changed[:count]:
            read, slope, information = _ONE / pixels[at[n], 1], pixels[at[n], 2], pixels[at[n], 3]
            to_plane = (read - ahead[n]) * slope
            if to_plane < _TWO * truncation:
                to_plane = (_interpolated(pixels, shape, uv[0, n], uv[1, n], read) - ahead[n]) * slope
            place = to_plane / truncation
            if place <= -_ONE:
                continue
            w = information * _share(place, read, ahead[n], slope)
            before, off = weight[m, n], min(to_plane, truncation) - distance[m, n]
            share = w / (w + before)
            if before > _ZERO and abs(to_plane) < _HALF * truncation:
                squares += off * off * share * before  # as much as they grow (Welford, Technometrics 1962)
                number += _ONE
            distance[m, n] += off * share
            weight[m, n] = w + before
            added += 1
        scatter[m, 0] += squares
        scatter[m, 1] += number
        readings[m] += added
