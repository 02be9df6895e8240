"""Where the map has observed a surface: cells of space in which views that the map learnt from have readings of depth.

Beyond them a neural map continues its surfaces as it likes. A frame that is aligned to what was never seen drifts away with it.
"""

import itertools
from typing import Any

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from idfslam.compute.backend import pick
from idfslam.geometry.blocks import distinct
from idfslam.storage.state import State, Stateful

# [m] Edge of a cell: about the truncation distance. A place is observed if a reading lies within half an edge of it along each axis, and
# places beyond one and a half edges are not. More: more of what a map invents beyond its border counts. Less: an error of a pose hides what
# was observed.
_CELL = 0.06
_BITS = 21  # of a cell's place along each axis. More: nothing, three of them just fit into 64 bits; they reach 60 km to each side
_ORIGIN = 1 << _BITS - 1  # added to a place, so that no number is negative: a fact, not a choice


def _keys(places: NDArray[Any]) -> NDArray[np.int64]:
    """A number for each of some cells, whose places are whole numbers (..., 3)."""
    x, y, z = np.moveaxis(places.astype(np.int64) + _ORIGIN, -1, 0)
    return np.asarray((x << 2 * _BITS) | (y << _BITS) | z)


_MEET = _keys(np.array(list(itertools.product((0, 1), repeat=3)))) - _keys(np.zeros(3))  # keys of cells before that of their corner


class ObservedSpace(Stateful):
    """The cells in which readings lie. Cells are never left: a loop moves a surface by less than a cell, or adds its new place."""

    def __init__(self) -> None:
        self._cells = np.zeros(0, np.int64)  # their keys, ascending

    def state(self) -> State:
        """The cells."""
        return {"cells": torch.from_numpy(self._cells)}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._cells = state["cells"].numpy().copy()

    def add(self, points: NDArray[np.floating]) -> None:
        """Adds the cells of readings (N, 3) [m] in the world, and for each reading the seven others that are nearest to it."""
        corners = distinct(_keys(np.floor(points / _CELL + 0.5)))  # of cells, the nearest to each reading: eight cells meet there
        keys = distinct(corners[:, None] - _MEET)
        new = keys[~_known(self._cells, keys)]
        if len(new):
            self._cells = np.sort(np.concatenate([self._cells, new]), kind="stable")  # which merges two ascending parts

    def contains(self, points: Tensor) -> Tensor:
        """Whether points (N, 3) [m] of the world lie in observed cells, (N,)."""
        return pick(points, compiled=compiled_contains, plain=plain_contains)(self._cells, points)


def plain_contains(cells: NDArray[np.int64], points: Tensor) -> Tensor:
    """Whether points (N, 3) [m] lie in cells, whose keys ascend: in numpy, for any device."""
    return torch.from_numpy(_known(cells, _keys(np.floor(points.detach().cpu().numpy() / _CELL)))).to(points.device)


def compiled_contains(cells: NDArray[np.int64], points: Tensor) -> Tensor:
    """`plain_contains` by Numba, on the CPU."""
    found, places = np.empty(len(points), np.bool_), points.numpy()
    _fill_contained(cells, places, places.dtype.type(_CELL), found)
    return torch.from_numpy(found)


def _known(cells: NDArray[np.int64], keys: NDArray[np.int64]) -> NDArray[np.bool_]:
    if not len(cells):
        return np.zeros(len(keys), bool)
    place = np.searchsorted(cells, keys).clip(max=len(cells) - 1)
    return np.asarray(cells[place] == keys)


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_contained(cells, points, edge, found) -> None:  # type: ignore[no-untyped-def]
    """Fills found (N,) with whether points (N, 3) lie in cells with this edge [m]."""
    for n in range(len(points)):
        x, y, z = np.floor(points[n, 0] / edge), np.floor(points[n, 1] / edge), np.floor(points[n, 2] / edge)
        key = ((np.int64(x) + _ORIGIN) << 2 * _BITS) | ((np.int64(y) + _ORIGIN) << _BITS) | (np.int64(z) + _ORIGIN)
        low, high = 0, len(cells)
        while low < high:
            middle = (low + high) // 2
            if cells[middle] < key:
                low = middle + 1
            else:
                high = middle
        found[n] = low < len(cells) and cells[low] == key
