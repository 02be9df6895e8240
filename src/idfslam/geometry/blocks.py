"""Cubic blocks of a lattice at integer multiples of their edge: packed into one key each, and found near depth readings."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.depth_view import DepthView

OFFSET = 1 << 20  # integer coordinates are packed into 21 bits each: +-1 048 576 half cells, 5 km at cells of 1 cm; larger ones do not fit


def pack(coordinates: NDArray) -> NDArray[np.int64]:
    """Integer coordinates (N, 3) as one sortable key (N,)."""
    x, y, z = (coordinates.astype(np.int64) + OFFSET).T
    return (x << 42) | (y << 21) | z


def unpack(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Integer coordinates (N, 3) of keys (N,): the inverse of `pack`."""
    mask = (1 << 21) - 1
    return np.stack([keys >> 42, (keys >> 21) & mask, keys & mask], -1) - OFFSET


def distinct(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """The different ones of some keys, ascending (M,). `np.unique` hashes them before it sorts, which takes three times as long."""
    ordered = np.sort(keys, axis=None)
    return ordered[np.append(True, ordered[1:] != ordered[:-1])[: len(ordered)]]


def touched_blocks(views: Sequence[DepthView], edge: float, margin: float, *, stride: int = 4) -> NDArray[np.int64]:
    """Integer coordinates (M, 3), sorted, of the blocks of edge `edge` [m] that come within `margin` [m] (per axis) of a depth reading.

    Readings of every `stride`-th row and column are used.
    """
    small = edge / 4  # readings are first reduced to small cells, so that few are dilated
    cells = [distinct(pack(_world_points(view, stride) // small)) for view in views]
    corner = unpack(distinct(np.concatenate(cells or [np.empty(0, np.int64)]))) * small
    low = np.floor((corner - margin) / edge).astype(np.int64)
    high = np.floor((corner + small + margin) / edge).astype(np.int64)
    reach = range(int(np.ceil((small + 2 * margin) / edge)) + 1)
    blocks = [distinct(pack(np.minimum(low + np.array([i, j, k]), high))) for i in reach for j in reach for k in reach]
    return unpack(distinct(np.concatenate(blocks)))


def _world_points(view: DepthView, stride: int) -> NDArray[np.float64]:
    """The readings (N, 3) [m] of every `stride`-th row and column."""
    v, u = np.mgrid[0 : view.camera.height : stride, 0 : view.camera.width : stride]
    z = view.depth[v, u].astype(np.float64)
    measured = z > 0
    u, v, z = u[measured], v[measured], z[measured]
    points = np.stack([(u - view.camera.cx) / view.camera.fx * z, (v - view.camera.cy) / view.camera.fy * z, z], -1)
    return points @ view.T_wc[:3, :3].T + view.T_wc[:3, 3]
