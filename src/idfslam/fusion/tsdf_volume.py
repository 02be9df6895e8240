"""A sparse grid of fused signed distance and its trust: blocks of voxels near surfaces, found by a hash table."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.compute.backend import pick
from idfslam.fusion.constants import BLOCK, LEAST_PART
from idfslam.geometry.blocks import pack

Floats = NDArray[np.float32]

STEPS = 1023  # of distance from the surface to the truncation: 0.04 mm at 4 cm. A fact of the map's format. More: larger files
_ROOM = 2  # [1] least number of places in the hash table over that of blocks. More: fewer collisions, more memory. Chosen by hand


@dataclass(frozen=True, eq=False)
class TsdfVolume:
    """M blocks of BLOCK^3 voxels. Voxel (i, j, k) of a block lies at (BLOCK * block + (i, j, k)) * voxel in the world."""

    voxel: float  # [m] edge
    truncation: float  # [m]
    blocks: NDArray[np.int64]  # (M, 3) integer coordinates
    distance: NDArray[np.int16]  # (M, BLOCK, BLOCK, BLOCK) [truncation / STEPS] up to STEPS, positive in front of the surface
    trust: NDArray[np.uint8]  # (M, BLOCK, BLOCK, BLOCK) [1/255] share of the fused distance in the surface

    def blend(self, points: Floats, otherwise: Floats) -> Floats:
        """The signed distance (N,) [m] at points (N, 3) [m]: the fused one by its trust, and `otherwise` (N,) [m] for the rest.

        It is continuous up to `LEAST_PART`: distance and trust are interpolated between voxels, and where there is no voxel the trust is 0.
        """
        form = pick(torch.empty(0), compiled=compiled_blend, plain=plain_blend)
        return form(self, points, otherwise)

    def blend_lattices(self, origins: NDArray[np.int64], cells: float, otherwise: Floats) -> Floats:
        """`blend` (B, S, S, S) [m] at the points (origins + (i, j, k)) * cells [m] of B lattices; otherwise (B, S, S, S) [m]."""
        form = pick(torch.empty(0), compiled=compiled_blend_lattices, plain=plain_blend_lattices)
        return form(self, origins, cells, otherwise)

    @cached_property
    def table(self) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """The hash table for kernels: keys (T,), -1 for none, and the block of each key (T,). T is a power of two."""
        from idfslam.fusion.kernels.numba_volume import fill_table

        places = 1 << int(np.ceil(np.log2(max(_ROOM * len(self.blocks), 2))))
        keys, rows = np.full(places, -1, np.int64), np.zeros(places, np.int32)
        fill_table(pack(self.blocks), keys, rows)
        return keys, rows

    @property
    def arrays(self) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int16], NDArray[np.uint8], float, float]:
        """What kernels need: `table`, distance, trust, the voxel's edge and a step of distance [m]."""
        return *self.table, self.distance, self.trust, self.voxel, self.truncation / STEPS


def no_volume() -> TsdfVolume:
    """A volume without blocks, for kernels: nothing is blended."""
    empty = np.zeros((0, BLOCK, BLOCK, BLOCK))
    return TsdfVolume(1.0, 1.0, np.zeros((0, 3), np.int64), empty.astype(np.int16), empty.astype(np.uint8))


def compiled_blend(volume: TsdfVolume, points: Floats, otherwise: Floats) -> Floats:
    """`TsdfVolume.blend`, compiled by Numba."""
    from idfslam.fusion.kernels.numba_volume import blend

    blended = np.empty(len(points), np.float32)
    blend(np.ascontiguousarray(points), np.ascontiguousarray(otherwise), *volume.arrays, blended)
    return blended


def plain_blend(volume: TsdfVolume, points: Floats, otherwise: Floats) -> Floats:
    """`TsdfVolume.blend` in numpy."""
    if not len(volume.blocks):
        return otherwise.copy()
    keys = pack(volume.blocks)
    order = np.argsort(keys)
    place = points.astype(np.float64) / volume.voxel
    low = np.floor(place).astype(np.int64)
    share = place - low
    blended = otherwise.astype(np.float64)
    for corner in np.ndindex(2, 2, 2):
        voxel = low + corner
        part = np.where(corner, share, 1 - share).prod(1)
        part[part < LEAST_PART] = 0
        key = pack(voxel // BLOCK)
        found = order[np.minimum(np.searchsorted(keys, key, sorter=order), len(keys) - 1)]
        at = (found, *(voxel % BLOCK).T)
        trust = np.where(keys[found] == key, volume.trust[at] / 255, 0)
        blended += part * trust * (volume.distance[at] * (volume.truncation / STEPS) - otherwise)
    return blended.astype(np.float32)


def compiled_blend_lattices(volume: TsdfVolume, origins: NDArray[np.int64], cells: float, otherwise: Floats) -> Floats:
    """`TsdfVolume.blend_lattices`, compiled by Numba."""
    from idfslam.fusion.kernels.numba_volume import blend_lattices

    blended = np.empty_like(otherwise)
    blend_lattices(origins, cells, np.ascontiguousarray(otherwise), *volume.arrays, blended)
    return blended


def plain_blend_lattices(volume: TsdfVolume, origins: NDArray[np.int64], cells: float, otherwise: Floats) -> Floats:
    """`TsdfVolume.blend_lattices` in numpy."""
    points = (origins[:, None, None, None] + np.moveaxis(np.indices(otherwise.shape[1:]), 0, -1)) * cells
    return plain_blend(volume, points.reshape(-1, 3).astype(np.float32), otherwise.reshape(-1)).reshape(otherwise.shape)
