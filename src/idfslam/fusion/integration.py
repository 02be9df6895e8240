"""The integration of depth images into a T-SDF (Curless and Levoy, SIGGRAPH 1996), with weights by the noise of the readings.

Each voxel has the mean of its distances to the surfaces that the images show along its rays, weighted by information: 1 / sigma^2, where
sigma grows with the square of depth, times the squared cosine between ray and normal. Distances are to the surface's plane, not along the
ray. Behind a surface the weights fall to zero at the truncation: what lies there is hidden, and may be the back of something thin. Before
it they fall to a tenth of what a reading of a surface in the voxel would have: a voxel that some images see past may be part of something
thin that others show. The voxel is as free if the surface behind it is far away or slanted; but no reading tells more than its information.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.compute.backend import pick
from idfslam.fusion.constants import BLOCK, EDGE_SHARE, ENOUGH, FREE, NEAREST, TILE
from idfslam.fusion.prepared_depth import PreparedDepth
from idfslam.geometry.projection import intrinsics_of
from idfslam.sensing.depth_noise import noise_ratio

Floats = NDArray[np.float32]

_CHUNK = 256  # blocks that the plain form adds to at a time. More: more memory. Chosen by hand


@dataclass(frozen=True, eq=False)
class Voxels:
    """What images have told of M blocks of voxels so far."""

    voxel: float  # [m] edge
    truncation: float  # [m]
    blocks: NDArray[np.int64]  # (M, 3) integer coordinates
    distance: Floats  # (M, BLOCK, BLOCK, BLOCK) [m]
    weight: Floats  # (M, BLOCK, BLOCK, BLOCK) [1/m^2]
    scatter: Floats  # (M, 2) squared deviations of distances near the surface over their expected variance, summed, and their number
    readings: NDArray[np.int64]  # (M,) number of readings of all voxels of a block

    @classmethod
    def empty(cls, voxel: float, truncation: float, blocks: NDArray[np.int64]) -> "Voxels":
        """Blocks at integer coordinates (M, 3) that no image has seen; voxel and truncation [m]."""
        distance, weight = (np.zeros((len(blocks), BLOCK, BLOCK, BLOCK), np.float32) for _ in range(2))
        return cls(voxel, truncation, blocks, distance, weight, np.zeros((len(blocks), 2), np.float32), np.zeros(len(blocks), np.int64))

    def part(self, rows: slice) -> "Voxels":
        """Some of the blocks, in the same memory."""
        voxels = self.distance[rows], self.weight[rows], self.scatter[rows], self.readings[rows]
        return Voxels(self.voxel, self.truncation, self.blocks[rows], *voxels)


def integrate(voxels: Voxels, view: PreparedDepth) -> None:
    """Adds a depth image to the voxels, in place."""
    pick(torch.empty(0), compiled=compiled_integrate, plain=plain_integrate)(voxels, view)


def compiled_integrate(voxels: Voxels, view: PreparedDepth) -> None:
    """`integrate`, compiled by Numba."""
    from idfslam.fusion.kernels.numba_integration import fill_pixels
    from idfslam.fusion.kernels.numba_integration import integrate as add

    T_cw, shape = np.linalg.inv(view.T_wc)[:3], view.depth.shape
    intrinsics = tuple(np.float32(value) for value in intrinsics_of(view.camera))
    origins = (voxels.blocks * (BLOCK * voxels.voxel)).astype(np.float32)
    lattice = (T_cw[:, :3] @ (np.indices([BLOCK] * 3).reshape(3, -1) * voxels.voxel)).astype(np.float32)
    pixels, deepest = np.zeros((view.depth.size + 1, 4), np.float32), np.zeros([-(-size // TILE) for size in shape], np.float32)
    fill_pixels(view.depth, view.slope, view.information, np.float32(voxels.truncation), pixels, deepest)
    image = T_cw.astype(np.float32), intrinsics, shape, pixels, deepest
    distance, weight = (array.reshape(-1, BLOCK**3) for array in (voxels.distance, voxels.weight))
    add(origins, lattice, np.float32(voxels.truncation), *image, distance, weight, voxels.scatter, voxels.readings)


def plain_integrate(voxels: Voxels, view: PreparedDepth) -> None:
    """`integrate` in numpy."""
    for start in range(0, len(voxels.blocks), _CHUNK):
        _add(voxels.part(slice(start, start + _CHUNK)), view)


def _add(voxels: Voxels, view: PreparedDepth) -> None:
    """Adds a depth image to the voxels, in place."""
    to_plane, w = _measured(voxels, view)
    w[voxels.readings >= ENOUGH * BLOCK**3] = 0
    voxels.readings[:] += (w > 0).sum((1, 2, 3))
    off = np.minimum(to_plane, voxels.truncation) - voxels.distance
    total = voxels.weight + w
    share = w / np.where(total > 0, total, 1)
    near = (w > 0) & (voxels.weight > 0) & (np.abs(to_plane) < voxels.truncation / 2)
    voxels.scatter[:, 0] += np.where(near, off**2 * share * voxels.weight, 0).sum((1, 2, 3))
    voxels.scatter[:, 1] += near.sum((1, 2, 3))
    voxels.distance[:] += (off * share).astype(np.float32)
    voxels.weight[:] += w.astype(np.float32)


def _measured(voxels: Voxels, view: PreparedDepth) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The distance [m] to the plane that an image shows, and its weight [1/m^2], 0: none, both (M, BLOCK, BLOCK, BLOCK)."""
    T_cw, c, truncation = np.linalg.inv(view.T_wc), view.camera, voxels.truncation
    lattice = np.stack(np.meshgrid(*[np.arange(BLOCK)] * 3, indexing="ij"), -1)
    points = (voxels.blocks[:, None, None, None] * BLOCK + lattice) * voxels.voxel
    x, y, ahead = np.moveaxis(points @ T_cw[:3, :3].T + T_cw[:3, 3], -1, 0)
    safe = np.where(ahead > NEAREST, ahead, 1)
    u, v = x / safe * c.fx + c.cx, y / safe * c.fy + c.cy
    column, row = np.floor(u + 0.5).astype(int), np.floor(v + 0.5).astype(int)
    inside = (ahead > NEAREST) & (column >= 0) & (column < c.width) & (row >= 0) & (row < c.height)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    read = np.where(inside, view.depth[row, column], 0).astype(np.float64)
    left, top = np.floor(u).astype(int), np.floor(v).astype(int)
    close = (read - ahead) * view.slope[row, column] < 2 * truncation
    between = inside & (read > 0) & close & (left >= 0) & (left < c.width - 1) & (top >= 0) & (top < c.height - 1)
    left, top = np.where(between, left, 0), np.where(between, top, 0)
    four = np.stack([view.depth[top + j, left + i] for j in range(2) for i in range(2)]).astype(np.float64)
    s, t, inverse = u - left, v - top, 1 / np.where(four > 0, four, 1)
    smooth = between & (four.min(0) > 0) & ((inverse.max(0) - inverse.min(0)) * read < EDGE_SHARE)
    interpolated = (1 - t) * ((1 - s) * inverse[0] + s * inverse[1]) + t * ((1 - s) * inverse[2] + s * inverse[3])
    to_plane = (np.where(smooth, 1 / np.where(smooth, interpolated, 1), read) - ahead) * view.slope[row, column]
    place, slope = to_plane / truncation, np.where(read > 0, view.slope[row, column], 1)
    free = FREE * (_noise(read) / (_noise(ahead) * slope)) ** 2
    share = np.where(place <= 0.5, 1 + place, np.maximum(2 - 2 * place, free)).clip(0, 1)
    w = view.information[row, column] * share
    return to_plane, np.where(read > 0, w, 0)


def _noise(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """`noise_ratio` of arrays."""
    return np.asarray(noise_ratio(torch.from_numpy(depth)).numpy())
