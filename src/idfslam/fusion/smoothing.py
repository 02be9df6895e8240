"""Noise taken out of fused distances: each is drawn towards those of the voxels around, as far as noise explains how it differs from them.

The signed distance of a plane is linear, so that the mean over neighbours on all sides leaves it as it is. At an edge or a corner voxels
differ from their neighbours by more than their noise: there little is smoothed (Lee, "Digital image enhancement and noise filtering by use
of local statistics", PAMI 1980). Where many near readings agree, nothing is smoothed.
"""

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.blocks import pack

Floats = NDArray[np.float32]


_ROUGHNESS = 0.0005  # [m] by which a surface that looks smooth may still bend. More: less is smoothed. Chosen by hand


def denoised(blocks: NDArray[np.int64], values: Floats, variance: Floats, seen: NDArray[np.bool_]) -> Floats:
    """Distances (M, B, B, B) [m] of which noise of a variance (M, B, B, B) [m^2] is taken out."""
    number = _sum_around(blocks, seen.astype(np.float32))
    off = _mean_around(blocks, values, seen, number) - values
    of_shape = np.maximum(_mean_around(blocks, off * off, seen, number) - variance, 0) + np.float32(_ROUGHNESS**2)
    return np.asarray(values + variance / (variance + of_shape) * off)


def around(blocks: NDArray[np.int64], values: Floats, seen: NDArray[np.bool_]) -> Floats:
    """The mean (M, B, B, B) of each voxel and those around it that were seen, by 1, 2, 1 along each axis; 0 where none was.

    Information is no weight here: it falls on both sides of a surface, and not alike, which would move the surface.
    """
    return _mean_around(blocks, values, seen, _sum_around(blocks, seen.astype(np.float32)))


def _mean_around(blocks: NDArray[np.int64], values: Floats, seen: NDArray[np.bool_], number: Floats) -> Floats:
    """`around`, where the weighted number (M, B, B, B) of voxels that were seen is known."""
    total = _sum_around(blocks, np.where(seen, values, np.float32(0)))
    return np.divide(total, number, out=np.zeros_like(total), where=number > 0)


def _sum_around(blocks: NDArray[np.int64], array: Floats) -> Floats:
    """The weighted sum (M, B, B, B) of each voxel and those around it."""
    for axis in range(3):
        before, after = (_neighbours(blocks, axis, step) for step in (-1, 1))
        array = _binomial(array, axis + 1, before, after)
    return array


def _neighbours(blocks: NDArray[np.int64], axis: int, step: int) -> NDArray[np.int64]:
    """(M,) the row of each block's neighbour along an axis; -1: it has none."""
    keys = pack(blocks)
    order = np.argsort(keys)
    wanted = pack(blocks + step * np.eye(3, dtype=np.int64)[axis])
    found = order[np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)]
    return np.where(keys[found] == wanted, found, -1)


def _binomial(array: Floats, axis: int, before: NDArray[np.int64], after: NDArray[np.int64]) -> Floats:
    """(1, 2, 1) / 4 along an axis of (M, B, B, B), over the borders of blocks; what has no neighbour counts as 0."""
    inner = np.moveaxis(array, axis, 1)
    sides = (np.where((rows >= 0)[:, None, None], inner[rows, end], 0)[:, None] for rows, end in ((before, -1), (after, 0)))
    first, last = sides
    padded = np.concatenate([first, inner, last], 1)
    smooth = (padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:]) / np.float32(4)
    return np.ascontiguousarray(np.moveaxis(smooth, 1, axis))
