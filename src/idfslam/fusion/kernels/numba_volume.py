"""Look-up in a sparse volume, compiled by Numba. `tsdf_volume` has the plain form."""

import numpy as np
from numba import njit, prange

from idfslam.fusion.constants import BLOCK, LEAST_PART
from idfslam.geometry.blocks import OFFSET

_MIX = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio (Knuth): a fact of multiplicative hashing
_inlined = njit(cache=True, nogil=True, error_model="numpy", forceinline=True)


@_inlined
def find(x, y, z, keys, rows):  # type: ignore[no-untyped-def]
    """The row of the block with integer coordinates x, y, z; -1 if there is none."""
    key = ((x + OFFSET) << 42) | ((y + OFFSET) << 21) | (z + OFFSET)
    mask = len(keys) - 1
    place = np.int64((np.uint64(key) * _MIX) >> np.uint64(32)) & mask
    while keys[place] != key:
        if keys[place] == -1:
            return -1
        place = (place + 1) & mask
    return np.int64(rows[place])


@njit(cache=True, nogil=True, error_model="numpy")
def fill_table(of_blocks, keys, rows):  # type: ignore[no-untyped-def]
    """Enters the keys of blocks (M,) into an empty table (T,)."""
    mask = len(keys) - 1
    for row in range(len(of_blocks)):
        place = np.int64((np.uint64(of_blocks[row]) * _MIX) >> np.uint64(32)) & mask
        while keys[place] != -1:
            place = (place + 1) & mask
        keys[place], rows[place] = of_blocks[row], row


@_inlined
def blend_at(x, y, z, otherwise, keys, rows, distance, trust, voxel, step):  # type: ignore[no-untyped-def]
    """The blended distance [m] at a point x, y, z [m]; otherwise [m]. The rest is `TsdfVolume.arrays`."""
    x, y, z = x / voxel, y / voxel, z / voxel
    i, j, k = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
    u, v, w = x - i, y - j, z - k
    blended = otherwise
    row, p, q, r = np.int64(-1), np.int64(OFFSET), np.int64(OFFSET), np.int64(OFFSET)  # of the last corner's block; none yet
    for corner in range(8):
        part = (u if corner & 1 else 1 - u) * (v if corner & 2 else 1 - v) * (w if corner & 4 else 1 - w)
        if part < LEAST_PART:
            continue
        a, b, c = i + (corner & 1), j + ((corner >> 1) & 1), k + (corner >> 2)
        if a // BLOCK != p or b // BLOCK != q or c // BLOCK != r:
            p, q, r = a // BLOCK, b // BLOCK, c // BLOCK
            row = find(p, q, r, keys, rows)
        if row < 0:
            continue
        l, m, n = a - p * BLOCK, b - q * BLOCK, c - r * BLOCK
        blended += part * (trust[row, l, m, n] / 255) * (distance[row, l, m, n] * step - otherwise)
    return blended


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def blend(points, otherwise, keys, rows, distance, trust, voxel, step, blended):  # type: ignore[no-untyped-def]
    """Fills the blended distances (N,) [m] at points (N, 3) [m]."""
    for n in prange(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        blended[n] = blend_at(x, y, z, otherwise[n], keys, rows, distance, trust, voxel, step)


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def blend_lattices(origins, cells, otherwise, keys, rows, distance, trust, voxel, step, blended):  # type: ignore[no-untyped-def]
    """Fills the blended distances (B, S, S, S) [m] of lattices with first points at `origins` (B, 3) [cells of `cells` m]."""
    side = otherwise.shape[1]
    for m in prange(len(origins)):
        for i in range(side):
            x = (origins[m, 0] + i) * cells
            for j in range(side):
                y = (origins[m, 1] + j) * cells
                for k in range(side):
                    z = (origins[m, 2] + k) * cells
                    blended[m, i, j, k] = blend_at(x, y, z, otherwise[m, i, j, k], keys, rows, distance, trust, voxel, step)
