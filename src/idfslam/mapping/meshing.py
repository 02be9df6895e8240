"""The surface of the map: marching cubes over the observed space, block by block, without unobserved surface.

The lattice lies at integer multiples of the cells in the world. So neighbouring blocks evaluate the same points on their common face, and
their triangles meet exactly. Where fused depth images tell finer shape than the network, cells are halved: the network is interpolated
between the points of the lattice of whole cells, and what is flat is put together again (`vertex_clustering`).
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import numpy as np
import torch
import trimesh
from numba import njit, prange
from numpy.typing import NDArray
from skimage.measure import marching_cubes
from torch import Tensor

from idfslam.compute.ahead import ahead
from idfslam.geometry.blocks import pack, touched_blocks
from idfslam.geometry.depth_view import DepthView
from idfslam.mapping.vertex_clustering import clustered

# First points (B, 3) [cells] of lattices, edge of the cells [m], values there (B, S, S, S) [tr] -> finer values (B, S, S, S) [tr]
Refinement: TypeAlias = Callable[[NDArray[np.int64], float, NDArray[np.float32]], NDArray[np.float32]]
_Lattice: TypeAlias = tuple[NDArray[np.int64], NDArray[np.float32]]

CELLS = 16  # cells along a block's edge. More: more points are evaluated away from the surface. Chosen by hand
_BATCH = 64  # blocks evaluated at a time: 64 * 17^3 = 314 k points. More: more memory. Chosen by hand
# [cells], [tr] Their sum is the largest distance of a vertex from a reading. More: surfaces extend beyond what was seen. Chosen by hand.
_CELLS_OFF, _TRUNCATIONS_OFF = 1.5, 0.3
# [1] that distance for a refined mesh and finer views, over the one above. More: surfaces go on behind outlines, where they are a guess by
# which precision is lost; less: sides that no view saw are missing. Chosen on generated rooms (docs/diary.md)
_OF_FINER = 0.75
# [1] views that look through a vertex, over those that observed it, above which it is removed. Less: outlines are ragged where images
# and poses are off by pixels. More: what was wrongly read, what lies behind an outline, and ghosts of what moved stay. Chosen on pictures
# of a kitchen, and on ghosts of people in a generated room (docs/diary.md)
_LOOKED_THROUGH = 3
_SLANT = 4 / 3  # [1] length of a ray at an image's corner over its depth, since the tolerance is in depth. More: more blocks are evaluated


def extract_mesh(
    sdf: Callable[[Tensor], Tensor],
    colour: Callable[[Tensor], Tensor] | None,
    views: Sequence[DepthView],
    *,
    resolution: float,
    truncation: float,
    device: torch.device | str = "cpu",
    stride: int = 4,
    refine: Refinement | None = None,
    finer: Iterable[DepthView] | None = None,
) -> trimesh.Trimesh:
    """The zero level of `sdf` where the views observed it, in metres, with vertex colours. Triangles face free space.

    sdf: points (N, 3) [m] on `device` -> (N,) [tr], positive in front of the surface. colour: points (N, 3) -> (N, 3) in [0, 1].
    refine: makes values of `sdf`, interpolated in lattices of half the resolution, finer ones. finer: the same views in more rows, if there
    are such, by which what was not observed is told.

    Vertices farther than 1.5 cells plus 0.3 tr from the views' readings are removed (`observed`); farther than three quarters of it, with
    `refine` and `finer`. Only blocks near a reading are evaluated, and for that test readings of every `stride`-th row and column are used.
    Memory: the triangles, and the lattice of 64 blocks at a time, whatever the size of the scene.
    """
    cells = resolution if refine is None else resolution / 2
    tolerance = _CELLS_OFF * cells + _TRUNCATIONS_OFF * truncation
    blocks = touched_blocks(views, CELLS * cells, _SLANT * tolerance, stride=stride)
    lattice = partial(_lattice, sdf, cells, device) if refine is None else partial(_refined, sdf, refine, cells, device)
    batches = (blocks[first : first + _BATCH] * CELLS for first in range(0, len(blocks), _BATCH))
    vertices, faces, keys = _concatenate(_march(ahead(lattice, batches), cells))
    faces = weld(faces, keys)
    if refine is not None:
        vertices, faces = clustered(vertices, faces, resolution)
    if finer is None:
        keep = observed(vertices, views, tolerance)
    else:
        keep = observed(vertices, finer, tolerance if refine is None else _OF_FINER * tolerance)
    faces = faces[keep[faces].all(1)]
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    vertices, faces = vertices[used], (np.cumsum(used) - 1)[faces]
    colours = None if colour is None else _evaluate(colour, vertices, device).clip(0, 1)
    return trimesh.Trimesh(
        vertices, faces, vertex_colors=None if colours is None else np.round(colours * 255).astype(np.uint8), process=False
    )


@dataclass(frozen=True)
class _Piece:
    """The triangles of one block."""

    vertices: NDArray[np.float64]  # (N, 3) [m]
    faces: NDArray[np.int64]  # (F, 3)
    keys: NDArray[np.int64]  # (N,) key of the lattice edge of a vertex on the block's faces; -1 for all others


def _lattice(sdf: Callable[[Tensor], Tensor], cells: float, device: torch.device | str, origins: NDArray[np.int64]) -> _Lattice:
    """The first points (B, 3) [cells] of some blocks, and `sdf` (B, CELLS + 1, CELLS + 1, CELLS + 1) in them."""
    values = _evaluate(sdf, _points(origins, CELLS + 1, 1) * cells, device)
    return origins, values.reshape(-1, CELLS + 1, CELLS + 1, CELLS + 1)


def _refined(
    sdf: Callable[[Tensor], Tensor], refine: Refinement, cells: float, device: torch.device | str, origins: NDArray[np.int64]
) -> _Lattice:
    """`_lattice` with `sdf` at every second point, interpolated between these, and refined."""
    side = CELLS // 2 + 1
    values = _evaluate(sdf, _points(origins, side, 2) * cells, device).reshape(-1, side, side, side)
    for axis in (1, 2, 3):
        values = _halved(values, axis)
    return origins, refine(origins, cells, values)


def _points(origins: NDArray[np.int64], side: int, step: int) -> NDArray[np.int64]:
    """The points (B * side^3, 3) of lattices of `side` points along each edge, `step` apart."""
    steps = np.arange(side) * step
    return (origins[:, None] + np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)).reshape(-1, 3)


def _halved(values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Values with the means of neighbours along an axis put between them."""
    values = np.moveaxis(values, axis, -1)
    fine = np.empty((*values.shape[:-1], 2 * values.shape[-1] - 1), np.float32)
    fine[..., ::2], fine[..., 1::2] = values, (values[..., 1:] + values[..., :-1]) / 2
    return np.ascontiguousarray(np.moveaxis(fine, -1, axis))


def _march(lattices: Iterator[_Lattice], cells: float) -> Iterator[_Piece]:
    """Marching cubes in each block that the surface passes through."""
    for origins, values in lattices:
        # A value of exactly zero would put the vertices of several edges onto one lattice point. So values stay 1e-4 away from zero.
        volumes = np.where(np.abs(values) < 1e-4, np.where(values < 0, -1e-4, 1e-4), values).astype(np.float32)
        crossed = (volumes.min((1, 2, 3)) < 0) & (volumes.max((1, 2, 3)) > 0)
        for i in np.flatnonzero(crossed):
            local, faces, _, _ = marching_cubes(volumes[i], 0.0, gradient_direction="descent", allow_degenerate=True)
            yield _Piece((local.astype(np.float64) + origins[i]) * cells, faces.astype(np.int64), _seam_keys(local, origins[i]))


def _seam_keys(local: NDArray, origin: NDArray[np.int64]) -> NDArray[np.int64]:
    """Keys (N,) of vertices (N, 3) [cells]: on the block's faces the packed middle, in half cells, of their lattice edge; else -1."""
    nearest = np.rint(local)
    off = np.abs(local - nearest)
    axis, rows = off.argmax(1), np.arange(len(local))  # along the other two axes the coordinates are integers, up to rounding
    middle = 2 * nearest
    middle[rows, axis] = 2 * np.floor(local[rows, axis]) + 1
    on_face = (((nearest == 0) | (nearest == CELLS)) & (off < 1e-5)).any(1)
    return np.where(on_face, pack(middle + 2 * origin), -1)


def _concatenate(pieces: Iterator[_Piece]) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """The vertices, faces and keys of all pieces."""
    vertices, faces, keys, count = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], [np.empty(0, np.int64)], 0
    for piece in pieces:
        vertices.append(piece.vertices)
        faces.append(piece.faces + count)
        keys.append(piece.keys)
        count += len(piece.vertices)
    return np.concatenate(vertices), np.concatenate(faces), np.concatenate(keys)


def weld(faces: NDArray[np.int64], keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Faces (F, 3) in which vertices with the same key are one vertex. Collapsed faces are dropped. keys (N,): -1 away from seams."""
    seam = np.flatnonzero(keys >= 0)
    _, first, inverse = np.unique(keys[seam], return_index=True, return_inverse=True)
    target = np.arange(len(keys))
    target[seam] = seam[first][inverse]
    faces = target[faces]
    return faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]


@torch.no_grad()
def _evaluate(function: Callable[[Tensor], Tensor], points: NDArray, device: torch.device | str) -> NDArray[np.float32]:
    """`function` of points (N, 3) in batches, as float32."""
    batches = torch.from_numpy(points.astype(np.float32)).split(1 << 18)
    return torch.cat([function(batch.to(device)).float().cpu() for batch in batches]).numpy()


def observed(vertices: NDArray[np.float64], views: Iterable[DepthView], tolerance: float) -> NDArray[np.bool_]:
    """Which vertices (N, 3) [m] the views observed: at least one view has a reading within `tolerance` [m] of the vertex's depth.

    The reading may be at any of the four pixels around the projection, so surface at a grazing angle counts. A view looked through the
    vertex if all its readings there are behind it. A vertex is removed if three or more views, and more than three times as many as
    observed it, looked through it. At fewer, chance would decide about the vertices at outlines.
    """
    near, through = np.zeros(len(vertices), np.int32), np.zeros(len(vertices), np.int32)
    for view in views:
        T_cw = np.linalg.inv(view.T_wc)
        intrinsics = (view.camera.fx, view.camera.fy, view.camera.cx, view.camera.cy)
        _vote(vertices, T_cw, np.ascontiguousarray(view.depth), intrinsics, tolerance, near, through)
    return (near > 0) & ~((through >= 3) & (through > _LOOKED_THROUGH * near))


@njit(parallel=True, cache=True)
def _vote(  # type: ignore[no-untyped-def]
    vertices, T_cw, depth, intrinsics, tolerance, near, through
):
    """Adds one view's votes to `near` and `through` (N,)."""
    fx, fy, cx, cy = intrinsics
    height, width = depth.shape
    for i in prange(len(vertices)):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        z_c = T_cw[2, 0] * x + T_cw[2, 1] * y + T_cw[2, 2] * z + T_cw[2, 3]
        if z_c <= 0:
            continue
        u = (T_cw[0, 0] * x + T_cw[0, 1] * y + T_cw[0, 2] * z + T_cw[0, 3]) / z_c * fx + cx
        v = (T_cw[1, 0] * x + T_cw[1, 1] * y + T_cw[1, 2] * z + T_cw[1, 3]) / z_c * fy + cy
        if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            continue
        left, top = int(np.floor(u)), int(np.floor(v))
        seen, valid, behind = False, 0, 0
        for row in range(max(top, 0), min(top + 2, height)):
            for column in range(max(left, 0), min(left + 2, width)):
                measured = depth[row, column]
                if measured > 0:
                    valid += 1
                    behind += measured > z_c + tolerance
                    seen |= abs(z_c - measured) <= tolerance
        near[i] += seen
        through[i] += valid > 0 and behind == valid
