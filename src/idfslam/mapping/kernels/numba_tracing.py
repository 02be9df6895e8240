"""Sphere tracing through a small field on the feature grid, on the CPU, compiled by Numba. `sphere_tracing.trace` is the plain form.

In torch a step of all rays takes thirty operations, and the few rays that graze a surface take most steps. Here a thread advances a block
of rays at a time, and grid and network stay in the cache. A ray that has ended is replaced by the next one.
"""

import numpy as np
from numba import njit, prange

from idfslam.fusion.kernels.numba_volume import blend_at
from idfslam.mapping.kernels.numba_field import BLOCK, head, linear, relu
from idfslam.mapping.kernels.numba_grid import locate, trilinear

_CHUNK = 2048  # rays that a thread traces at a time. More: less even work for the threads. Chosen by hand

_ZERO, _ONE = np.float32(0), np.float32(1)
_FASTMATH = {"contract", "reassoc", "nsz", "arcp"}


@njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", parallel=True)  # type: ignore[untyped-decorator]
def trace(  # type: ignore[no-untyped-def] # noqa: C901 (a ray's life, a block of them at a time)
    origins,
    directions,
    near,
    far,
    reach,
    caution,
    least,
    tables,
    inverse,
    lanes,
    w1,
    b1,
    ws,
    bs,
    truncation,
    keys,
    rows,
    distance,
    trust,
    voxel,
    step,
    depth,
):
    """Fills depth (N,) at which rays from near (N,) on first pass from the front of a surface to its back; unchanged for other rays.

    reach (N,): the truncation distance in depth along each ray. caution: the share of the distance in a step. least: the least step [tr].
    keys to step: `TsdfVolume.arrays` of the volume that is blended with the network.
    """
    inputs, hidden, width = w1.shape[1], w1.shape[0], len(lanes)
    mask = np.uint32(tables.shape[1] - 1)
    for chunk in prange((len(origins) + _CHUNK - 1) // _CHUNK):
        following, end = chunk * _CHUNK, min(len(origins), (chunk + 1) * _CHUNK)
        e, xyz, fraction = np.empty((8, BLOCK), np.uint32), np.empty((3, BLOCK), np.float32), np.empty((3, BLOCK), np.float32)
        x, h, s = np.zeros((inputs, BLOCK), np.float32), np.empty((hidden, BLOCK), np.float32), np.empty((1, BLOCK), np.float32)
        ray, t = np.empty(BLOCK, np.int64), np.empty(BLOCK, np.float32)
        t_before, before = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)  # where each was one step earlier, and the T-SDF there
        count = 0
        while True:
            while count < BLOCK and following < end:
                ray[count], t[count], t_before[count], before[count] = following, near[following], near[following], -_ONE
                count += 1
                following += 1
            if count == 0:
                break
            for i in range(count):
                for axis in range(3):
                    xyz[axis, i] = origins[ray[i], axis] + directions[ray[i], axis] * t[i]
            for level in range(len(tables)):
                table = tables[level]
                locate(xyz, count, inverse[level], mask, e, fraction)
                for i in range(count):
                    u, v, w = fraction[0, i], fraction[1, i], fraction[2, i]
                    e0, e1, e2, e3, e4, e5, e6, e7 = e[0, i], e[1, i], e[2, i], e[3, i], e[4, i], e[5, i], e[6, i], e[7, i]
                    for f in range(width):
                        x[level * width + f, i], _, _, _ = trilinear(
                            table[e0, f],
                            table[e1, f],
                            table[e2, f],
                            table[e3, f],
                            table[e4, f],
                            table[e5, f],
                            table[e6, f],
                            table[e7, f],
                            u,
                            v,
                            w,
                        )
            linear(w1, b1, x, h)
            relu(h)
            head(ws, bs, h, s)
            kept = 0
            for i in range(count):
                of_network = s[0, i] * truncation
                here = blend_at(xyz[0, i], xyz[1, i], xyz[2, i], of_network, keys, rows, distance, trust, voxel, step) / truncation
                if before[i] > _ZERO and here <= _ZERO:
                    depth[ray[i]] = t_before[i] + (t[i] - t_before[i]) * (before[i] / (before[i] - here))
                    continue
                onward = t[i] + caution * min(max(abs(here), least), _ONE) * reach[ray[i]]
                if onward < far:
                    ray[kept], t_before[kept], before[kept], t[kept] = ray[i], t[i], here, onward
                    kept += 1
            count = kept
