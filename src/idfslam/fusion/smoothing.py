"""Noise taken out of fused distances: each is drawn towards those of the voxels around, as far as noise explains how it differs from them.

The signed distance of a plane is linear, so that the mean over neighbours on all sides leaves it as it is. At an edge or a corner voxels
differ from their neighbours by more than their noise: there little is smoothed (Lee, "Digital image enhancement and noise filtering by use
of local statistics", PAMI 1980). Where many near readings agree, nothing is smoothed.
"""

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.compute.backend import pick
from idfslam.fusion.constants import BLOCK
from idfslam.geometry.blocks import pack

Floats = NDArray[np.float32]

_ROUGHNESS = 0.0005  # [m] by which a surface that looks smooth may still bend. More: less is smoothed. Chosen by hand


def denoised(blocks: NDArray[np.int64], values: Floats, variance: Floats, seen: NDArray[np.bool_]) -> Floats:
    """Distances (M, B, B, B) [m] of which noise of a variance (M, B, B, B) [m^2] is taken out."""
    neighbours = neighbours_of(blocks)
    number = sums_around(neighbours, seen.astype(np.float32))
    off = _mean_around(neighbours, values, seen, number) - values
    of_shape = np.maximum(_mean_around(neighbours, off * off, seen, number) - variance, 0) + np.float32(_ROUGHNESS**2)
    return np.asarray(values + variance / (variance + of_shape) * off)


def around(blocks: NDArray[np.int64], values: Floats, seen: NDArray[np.bool_]) -> Floats:
    """The mean (M, B, B, B) of each voxel and those around it that were seen, by 1, 2, 1 along each axis; 0 where none was.

    Information is no weight here: it falls on both sides of a surface, and not alike, which would move the surface.
    """
    neighbours = neighbours_of(blocks)
    return _mean_around(neighbours, values, seen, sums_around(neighbours, seen.astype(np.float32)))


def _mean_around(neighbours: NDArray[np.int64], values: Floats, seen: NDArray[np.bool_], number: Floats) -> Floats:
    """`around`, where the weighted number (M, B, B, B) of voxels that were seen is known."""
    total = sums_around(neighbours, np.where(seen, values, np.float32(0)))
    return np.divide(total, number, out=np.zeros_like(total), where=number > 0)


def neighbours_of(blocks: NDArray[np.int64]) -> NDArray[np.int64]:
    """(M, 3, 3, 3) the rows of the blocks around each block, itself in the middle; -1: there is none."""
    keys = pack(blocks)
    order = np.argsort(keys)
    rows = np.empty((len(blocks), 3, 3, 3), np.int64)
    for i, j, k in np.ndindex(3, 3, 3):
        wanted = pack(blocks + np.array([i, j, k]) - 1)
        found = order[np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)] if len(keys) else order
        rows[:, i, j, k] = np.where(keys[found] == wanted, found, -1)
    return rows


def sums_around(neighbours: NDArray[np.int64], array: Floats) -> Floats:
    """The weighted sums (M, B, B, B) of each voxel and those around it, by 1, 2, 1 along each axis; what is in no block counts as 0."""
    return pick(torch.empty(0), compiled=compiled_sums_around, plain=plain_sums_around)(neighbours, array)


def compiled_sums_around(neighbours: NDArray[np.int64], array: Floats) -> Floats:
    """`sums_around`, compiled by Numba."""
    from idfslam.fusion.kernels.numba_smoothing import sums_around as fill

    sums = np.empty_like(array)
    fill(neighbours, array, sums)
    return sums


def plain_sums_around(neighbours: NDArray[np.int64], array: Floats) -> Floats:
    """`sums_around` in numpy."""
    wide = np.zeros((len(array), *[BLOCK + 2] * 3), np.float32)
    to = slice(0, 1), slice(1, BLOCK + 1), slice(BLOCK + 1, BLOCK + 2)
    of = slice(BLOCK - 1, BLOCK), slice(0, BLOCK), slice(0, 1)
    for i, j, k in np.ndindex(3, 3, 3):
        rows = neighbours[:, i, j, k]
        wide[rows >= 0, to[i], to[j], to[k]] = array[rows[rows >= 0], of[i], of[j], of[k]]
    for axis in range(3):
        wide = np.moveaxis(wide, axis + 1, 0)
        wide = np.moveaxis((wide[:-2] + 2 * wide[1:-1] + wide[2:]) / np.float32(4), 0, axis + 1)
    return np.ascontiguousarray(wide)
