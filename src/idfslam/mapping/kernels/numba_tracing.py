"""Sphere tracing through a small field on the feature grid, on the CPU, compiled by Numba. `sphere_tracing.trace` is the plain form.

In torch a step of all rays takes thirty operations, and the few rays that graze a surface take most steps. Here a thread advances a block
of rays at a time, and grid and network stay in the cache. A ray that has ended is replaced by the next one.
"""

import numpy as np
from numba import njit, prange

from idfslam.fusion.kernels.numba_volume import blend_at
from idfslam.mapping.kernels.numba_field import BLOCK, gather, head, linear, relu

_CHUNK = 2048  # rays that a thread traces at a time. More: less even work for the threads. Chosen by hand

_ZERO, _ONE = np.float32(0), np.float32(1)
_FASTMATH = {"contract", "reassoc", "nsz", "arcp"}

_inlined = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", forceinline=True)


@_inlined
def _refill(ray, t, t_before, before, count, following, end, near):  # type: ignore[no-untyped-def]
    """Starts the rays from `following` to `end` in the free places of a block. Returns how many the block has, and the ray that follows."""
    while count < BLOCK and following < end:
        ray[count], t[count], t_before[count], before[count] = following, near[following], near[following], -_ONE
        count += 1
        following += 1
    return count, following


@_inlined
def _advance(ray, t, t_before, before, count, here, limits, reach, depth):  # type: ignore[no-untyped-def]
    """Ends the rays of a block that are behind a surface or too far, and moves the others on. Returns how many are left."""
    far, caution, least = limits
    kept = 0
    for i in range(count):
        if before[i] > _ZERO and here[i] <= _ZERO:
            depth[ray[i]] = t_before[i] + (t[i] - t_before[i]) * (before[i] / (before[i] - here[i]))
            continue
        onward = t[i] + caution * min(max(abs(here[i]), least), _ONE) * reach[ray[i]]
        if onward < far:
            ray[kept], t_before[kept], before[kept], t[kept] = ray[i], t[i], here[i], onward
            kept += 1
    return kept


@njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", parallel=True)  # type: ignore[untyped-decorator]
def trace(rays, limits, grid, network, truncation, volume, depth):  # type: ignore[no-untyped-def]
    """Fills depth (N,) at which rays first pass from the front of a surface to its back; unchanged for other rays.

    rays: origins (N, 3), directions (N, 3), the depth (N,) from which on they are followed, and the truncation distance (N,) in depth
    along each. limits: the largest depth, the share of the distance in a step, and the least step [tr]. grid, network: as for
    `numba_field.distance`. volume: `TsdfVolume.arrays` of the volume that is blended with the network.
    """
    origins, directions, near, reach = rays
    tables, inverse, lanes = grid
    w1, b1, ws, bs = network
    keys, rows, distance, trust, voxel, step = volume
    for chunk in prange((len(origins) + _CHUNK - 1) // _CHUNK):
        following, end = chunk * _CHUNK, min(len(origins), (chunk + 1) * _CHUNK)
        e, xyz, fraction = np.empty((8, BLOCK), np.uint32), np.empty((3, BLOCK), np.float32), np.empty((3, BLOCK), np.float32)
        x, h = np.zeros((w1.shape[1], BLOCK), np.float32), np.empty((w1.shape[0], BLOCK), np.float32)
        s, here = np.empty((1, BLOCK), np.float32), np.empty(BLOCK, np.float32)
        ray, t = np.empty(BLOCK, np.int64), np.empty(BLOCK, np.float32)
        t_before, before = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)  # where each was one step earlier, and the T-SDF there
        count, following = _refill(ray, t, t_before, before, 0, following, end, near)
        while count > 0:
            for i in range(count):
                for axis in range(3):
                    xyz[axis, i] = origins[ray[i], axis] + directions[ray[i], axis] * t[i]
            gather(xyz, count, tables, inverse, lanes, e, fraction, x)
            linear(w1, b1, x, h)
            relu(h)
            head(ws, bs, h, s)
            for i in range(count):
                learnt = s[0, i] * truncation
                here[i] = blend_at(xyz[0, i], xyz[1, i], xyz[2, i], learnt, keys, rows, distance, trust, voxel, step) / truncation
            count = _advance(ray, t, t_before, before, count, here, limits, reach, depth)
            count, following = _refill(ray, t, t_before, before, count, following, end, near)
