"""Exports the map as a regular grid: T-SDF and colour at lattice points, and whether each point was observed.

`tsdf` (X, Y, Z) float32 is in [-1, 1] units of `truncation` [m], positive in front of the surface; `colour` (X, Y, Z, 3) uint8 RGB;
`observed` (X, Y, Z) bool: the point is in free space in front of a measured depth, or at most the truncation behind it. At all other points
`tsdf` is 1 and has no meaning. Lattice point [i, j, k] lies at `origin` + (i, j, k) * `voxel_size` [m] in the axes of the export;
`T_export_world` (4, 4) maps the run's world into them.

The format `blocks` keeps only the blocks near a surface: its first axis counts M blocks, and `origin` (M, 3) has one row for each.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numba import njit, prange
from numpy.typing import NDArray

from idfslam.errors import ConfigError
from idfslam.geometry.blocks import touched_blocks
from idfslam.geometry.depth_view import DepthView
from idfslam.geometry.projection import intrinsics_of, project
from idfslam.mapping.implicit_surface import ImplicitSurface
from idfslam.mapping.meshing import CELLS
from idfslam.mapping.saved_map import SavedMap

_LARGEST = 1 << 28  # lattice points of a dense grid, which take about 2 GB; larger: finer grids are allowed
_CHUNK = 64  # blocks evaluated at a time; larger: more memory


@dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks of CELLS^3 lattice points near the surface."""

    coordinates: NDArray[np.int64]  # (M, 3) integer, in blocks
    tsdf: NDArray[np.float32]  # (M, C, C, C) [tr]
    colour: NDArray[np.uint8]  # (M, C, C, C, 3)
    observed: NDArray[np.bool_]  # (M, C, C, C)


def sample_blocks(saved: SavedMap, voxel: float, T_ew: NDArray[np.float64]) -> Blocks:
    """The field in all blocks near a measured surface, at lattice points `voxel` [m] apart. T_ew (4, 4): world into the lattice's axes."""
    tr, views = saved.field.config.truncation, _turned(saved.views, T_ew)
    coordinates = touched_blocks(views, CELLS * voxel, tr)
    chunks = list(_evaluate(saved.surface, coordinates, voxel, np.linalg.inv(T_ew).astype(np.float32)))
    shape = (len(coordinates), CELLS, CELLS, CELLS)
    points = _lattice(coordinates, voxel)
    seen = observed_space(points.reshape(-1, 3), views, tr).reshape(shape)
    tsdf = np.concatenate([chunk[0] for chunk in chunks]).reshape(shape)
    colour = np.concatenate([chunk[1] for chunk in chunks]).reshape(*shape, 3)
    return Blocks(coordinates, np.where(seen, tsdf, np.float32(1)), np.where(seen[..., None], colour, np.uint8(0)), seen)


def _turned(views: Sequence[DepthView], T_ew: NDArray[np.float64]) -> list[DepthView]:
    """The views, with their poses in other axes."""
    return [DepthView(T_ew @ view.T_wc, view.depth, view.camera) for view in views]


def _lattice(coordinates: NDArray[np.int64], voxel: float) -> NDArray[np.float32]:
    """(M, C^3, 3) [m]."""
    offsets = np.stack(np.meshgrid(*[np.arange(CELLS)] * 3, indexing="ij"), -1).reshape(-1, 3)
    return ((coordinates[:, None] * CELLS + offsets) * voxel).astype(np.float32)


@torch.no_grad()
def _evaluate(
    surface: ImplicitSurface, coordinates: NDArray[np.int64], voxel: float, T_we: NDArray[np.float32]
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.uint8]]]:
    """T-SDF and colour, `_CHUNK` blocks at a time."""
    field = surface.field
    device = next(field.parameters()).device
    for start in range(0, len(coordinates), _CHUNK):
        lattice = _lattice(coordinates[start : start + _CHUNK], voxel).reshape(-1, 3)
        points = torch.from_numpy(lattice @ T_we[:3, :3].T + T_we[:3, 3]).to(device)
        near = surface.sdf(points).clamp(-1, 1)
        towards = -field.distance(points)[1] if field.direction_encoding is not None else None
        colour = (field(points, towards)[1].clamp(0, 1) * 255).round().to(torch.uint8)
        yield near.cpu().numpy(), colour.cpu().numpy()


def save_blocks(path: Path, saved: SavedMap, voxel: float, T_ew: NDArray[np.float64]) -> None:
    """Writes the blocks as npz."""
    blocks = sample_blocks(saved, voxel, T_ew)
    values: dict[str, Any] = {"tsdf": blocks.tsdf, "colour": blocks.colour, "observed": blocks.observed}
    _save(path, saved, voxel, T_ew, origin=blocks.coordinates * CELLS * voxel, **values)


def save_grid(path: Path, saved: SavedMap, voxel: float, T_ew: NDArray[np.float64]) -> None:
    """Writes one dense grid as npz. Raises ConfigError if it would be too large."""
    tr, views = saved.field.config.truncation, _turned(saved.views, T_ew)
    low, high = _extent(touched_blocks(views, CELLS * voxel, tr))
    size = (high - low) * CELLS
    if np.prod(size.astype(float)) > _LARGEST:
        shape = " x ".join(map(str, size))
        raise ConfigError(f"--resolution {voxel}: a dense grid would have {shape} points; choose a larger one, or --to blocks")
    blocks = sample_blocks(saved, voxel, T_ew)
    tsdf, colour = np.ones(size, np.float32), np.zeros((*size, 3), np.uint8)
    axes = [np.arange(low[a] * CELLS, high[a] * CELLS, dtype=np.float32) * np.float32(voxel) for a in range(3)]
    seen = np.zeros(size, bool)
    for i, x in enumerate(axes[0]):  # one slice at a time: the points of the whole lattice would take four times the memory of the grid
        plane = np.stack(np.meshgrid(x, axes[1], axes[2], indexing="ij"), -1).reshape(-1, 3)
        seen[i] = observed_space(plane, views, tr).reshape(size[1:])
    for (x, y, z), *values in zip((blocks.coordinates - low) * CELLS, blocks.tsdf, blocks.colour):
        place = (slice(x, x + CELLS), slice(y, y + CELLS), slice(z, z + CELLS))
        tsdf[place], colour[place] = values
    _save(path, saved, voxel, T_ew, origin=low * CELLS * voxel, tsdf=tsdf, colour=colour, observed=seen)


def _save(path: Path, saved: SavedMap, voxel: float, T_ew: NDArray[np.float64], **values: Any) -> None:
    with path.open("wb") as file:
        np.savez_compressed(file, **values, voxel_size=voxel, truncation=saved.field.config.truncation, T_export_world=T_ew)


def _extent(coordinates: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    return coordinates.min(0), coordinates.max(0) + 1


def observed_space(points: NDArray[np.float32], views: Sequence[DepthView], behind: float) -> NDArray[np.bool_]:
    """Whether points (N, 3) [m] were observed: a view's depth at the point's pixel ends at most `behind` [m] in front of the point."""
    seen = np.zeros(len(points), np.bool_)
    for view in views:
        _mark_observed(points, np.linalg.inv(view.T_wc), np.ascontiguousarray(view.depth), intrinsics_of(view.camera), behind, seen)
    return seen


@njit(parallel=True, cache=True)
def _mark_observed(points, T_cw, depth, intrinsics, behind, seen):  # type: ignore[no-untyped-def]
    """Marks in `seen` (N,) the points that one view observed."""
    height, width = depth.shape
    for i in prange(len(points)):
        if seen[i]:
            continue
        u, v, z_c = project(T_cw, points[i], intrinsics)
        column, row = round(u), round(v)
        if z_c > 0 and 0 <= column < width and 0 <= row < height:
            measured = depth[int(row), int(column)]
            seen[i] = measured > 0 and z_c <= measured + behind
