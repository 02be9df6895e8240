"""The smoothing of fused distances, compiled by Numba. `smoothing` has the plain form."""

import numpy as np
from numba import njit, prange

from idfslam.fusion.constants import BLOCK

_WIDE = BLOCK + 2  # voxels along a block with those around it
_ZERO, _TWO, _FOUR = np.float32(0), np.float32(2), np.float32(4)

_inlined = njit(cache=True, nogil=True, error_model="numpy", forceinline=True)


@_inlined
def _gather(m, neighbours, array, wide):  # type: ignore[no-untyped-def]
    """Copies block m of an array (M, BLOCK, BLOCK, BLOCK), and the voxels around it, to `wide`; 0 where there is no block."""
    for a in range(3):
        i0, i1, from_i = (0, 1, BLOCK - 1) if a == 0 else ((1, BLOCK + 1, 0) if a == 1 else (BLOCK + 1, _WIDE, 0))
        for b in range(3):
            j0, j1, from_j = (0, 1, BLOCK - 1) if b == 0 else ((1, BLOCK + 1, 0) if b == 1 else (BLOCK + 1, _WIDE, 0))
            for c in range(3):
                k0, k1, from_k = (0, 1, BLOCK - 1) if c == 0 else ((1, BLOCK + 1, 0) if c == 1 else (BLOCK + 1, _WIDE, 0))
                row = neighbours[m, a, b, c]
                for i in range(i0, i1):
                    for j in range(j0, j1):
                        for k in range(k0, k1):
                            wide[i, j, k] = array[row, i - i0 + from_i, j - j0 + from_j, k - k0 + from_k] if row >= 0 else _ZERO


@_inlined
def _binomial(wide, once, twice, total):  # type: ignore[no-untyped-def]
    """The sums `total` (BLOCK, BLOCK, BLOCK) of each voxel of `wide` and those around it, by (1, 2, 1) / 4 along each axis."""
    for i in range(BLOCK):
        for j in range(_WIDE):
            for k in range(_WIDE):
                once[i, j, k] = (wide[i, j, k] + _TWO * wide[i + 1, j, k] + wide[i + 2, j, k]) / _FOUR
    for i in range(BLOCK):
        for j in range(BLOCK):
            for k in range(_WIDE):
                twice[i, j, k] = (once[i, j, k] + _TWO * once[i, j + 1, k] + once[i, j + 2, k]) / _FOUR
    for i in range(BLOCK):
        for j in range(BLOCK):
            for k in range(BLOCK):
                total[i, j, k] = (twice[i, j, k] + _TWO * twice[i, j, k + 1] + twice[i, j, k + 2]) / _FOUR


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def sums_around(neighbours, array, sums):  # type: ignore[no-untyped-def]
    """Fills the weighted sums (M, BLOCK, BLOCK, BLOCK) of each voxel of `array` and those around it.

    neighbours (M, 3, 3, 3): rows of the blocks around each block, itself in the middle; -1: there is none. All numbers are float32.
    """
    for m in prange(len(neighbours)):
        wide = np.empty((_WIDE, _WIDE, _WIDE), np.float32)
        once = np.empty((BLOCK, _WIDE, _WIDE), np.float32)
        twice = np.empty((BLOCK, BLOCK, _WIDE), np.float32)
        _gather(m, neighbours, array, wide)
        _binomial(wide, once, twice, sums[m])
