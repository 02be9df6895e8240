"""Multi-resolution hash grid on the CPU, compiled by Numba: the contract of `torch_grid`, float32 only.

Points are processed in blocks. The hashes of a block at one level are computed first, in a loop that vectorises. The gathers follow while
the block's inputs and outputs are in the first-level cache. The tables' gradient is split by level, so no two threads write to one table,
and no atomics are needed.

Kernels are compiled at the first call and cached on disk. `fastmath` keeps infinities and NaN, so that a diverged field is detected. A
point that is not finite reads some valid entry and yields NaN. Coordinates are counted in int32: |x| / cell must be below 2^31.

Helpers are inlined by force. Otherwise each would exist by itself and as a copy in every caller, optimised differently. Which copy runs
would depend on what a process loads first. The copies' sums round differently, so a run would not repeat to the bit.
"""

import numba
import numpy as np
import torch
from numba import njit, prange
from numpy.typing import NDArray
from torch import Tensor

from idfslam.mapping.kernels.torch_grid import BETAS, EPS, RUN, Rates, adam_rates, touched_runs

Floats = NDArray[np.float32]
Entries = NDArray[np.uint32]
Flags = NDArray[np.uint8]

BLOCK = 256  # points in a block: 8 x 256 corner entries and 256 rows of 64 bytes of output fit the first-level cache. More: they do not
ADAM_BLOCK = 128  # runs of a table that a thread processes at a time. More: less even work for the threads
ADAM_LINE = 32  # numbers that are skipped together if they have no gradient. More: they are skipped less often. Less: no vectorisation

# Primes of the hash of a block of vertices, times its 8 entries
_X8, _Y8, _Z8 = np.uint32(8), np.uint32(2_654_435_761 * 8 % 2**32), np.uint32(805_459_861 * 8 % 2**32)
_UNIT, _TWO = np.uint32(1), np.uint32(2)
_ONE = np.float32(1)
_FASTMATH = {"contract", "reassoc", "nsz", "arcp"}

_inlined = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", forceinline=True)
_parallel = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", parallel=True)


@_inlined
def stage(points: Floats, start: int, count: int, xyz: Floats) -> None:
    """Copies a block of points to `xyz` (3, BLOCK), in which each coordinate is contiguous."""
    for i in range(count):
        for axis in range(3):
            xyz[axis, i] = points[start + i, axis]


@_inlined
def _part(vertex: np.uint32, prime8: np.uint32, shift: np.uint32) -> np.uint32:
    """The part of one coordinate in a vertex's hash (`torch_grid.hash_vertices`): the block's hash, and a bit of the place within it."""
    return np.uint32(np.uint32((vertex >> _UNIT) * prime8) ^ np.uint32((vertex & _UNIT) << shift))


@_inlined
def locate(xyz: Floats, count: int, inverse: np.float32, mask: np.uint32, entries: Entries, fraction: Floats) -> None:
    """Fills `entries` (8, BLOCK), x changing fastest, and `fraction` (3, BLOCK) for one block of points at one level.

    Numba widens uint32 arithmetic to 64 bits. With the casts after every operation the loop vectorises over 32-bit lanes.
    """
    for i in range(count):
        u, v, w = xyz[0, i] * inverse, xyz[1, i] * inverse, xyz[2, i] * inverse
        x_floor, y_floor, z_floor = np.floor(u), np.floor(v), np.floor(w)
        fraction[0, i], fraction[1, i], fraction[2, i] = u - x_floor, v - y_floor, w - z_floor
        x, y, z = np.uint32(np.int32(x_floor)), np.uint32(np.int32(y_floor)), np.uint32(np.int32(z_floor))
        x0, x1 = _part(x, _X8, np.uint32(0)), _part(np.uint32(x + _UNIT), _X8, np.uint32(0))
        y0, y1 = _part(y, _Y8, _UNIT), _part(np.uint32(y + _UNIT), _Y8, _UNIT)
        z0, z1 = _part(z, _Z8, _TWO), _part(np.uint32(z + _UNIT), _Z8, _TWO)
        a, b, c, d = np.uint32(y0 ^ z0), np.uint32(y1 ^ z0), np.uint32(y0 ^ z1), np.uint32(y1 ^ z1)
        entries[0, i], entries[1, i] = np.uint32((x0 ^ a) & mask), np.uint32((x1 ^ a) & mask)
        entries[2, i], entries[3, i] = np.uint32((x0 ^ b) & mask), np.uint32((x1 ^ b) & mask)
        entries[4, i], entries[5, i] = np.uint32((x0 ^ c) & mask), np.uint32((x1 ^ c) & mask)
        entries[6, i], entries[7, i] = np.uint32((x0 ^ d) & mask), np.uint32((x1 ^ d) & mask)


@_inlined
def trilinear(c0, c1, c2, c3, c4, c5, c6, c7, u, v, w):  # type: ignore[no-untyped-def]
    """The value, and its derivatives by u, v and w, of the interpolation between 8 corners, x changing fastest."""
    d0, d2, d4, d6 = c1 - c0, c3 - c2, c5 - c4, c7 - c6
    b0, b2, b4, b6 = c0 + u * d0, c2 + u * d2, c4 + u * d4, c6 + u * d6
    e0, e4 = b2 - b0, b6 - b4
    a0, a4 = b0 + v * e0, b4 + v * e4
    slope_low, slope_high = d0 + v * (d2 - d0), d4 + v * (d6 - d4)
    return a0 + w * (a4 - a0), slope_low + w * (slope_high - slope_low), e0 + w * (e4 - e0), a4 - a0


@_parallel
def _forward(points: Floats, tables: Floats, inverse: Floats, lanes: tuple[int, ...], features: Floats) -> None:
    width = len(lanes)  # known when compiled, so that loops over the features of an entry are unrolled
    mask = np.uint32(tables.shape[1] - 1)
    for block in prange((len(points) + BLOCK - 1) // BLOCK):
        start = block * BLOCK
        count = min(len(points) - start, BLOCK)
        e = np.empty((8, BLOCK), np.uint32)
        xyz, fraction = np.empty((3, BLOCK), np.float32), np.empty((3, BLOCK), np.float32)
        stage(points, start, count, xyz)
        for level in range(len(tables)):
            table = tables[level]
            locate(xyz, count, inverse[level], mask, e, fraction)
            for i in range(count):
                u, v, w = fraction[0, i], fraction[1, i], fraction[2, i]
                low, high = (_ONE - v) * (_ONE - w), (_ONE - v) * w
                low1, high1 = v * (_ONE - w), v * w
                for f in range(width):
                    features[start + i, level * width + f] = (
                        low * ((_ONE - u) * table[e[0, i], f] + u * table[e[1, i], f])
                        + low1 * ((_ONE - u) * table[e[2, i], f] + u * table[e[3, i], f])
                        + high * ((_ONE - u) * table[e[4, i], f] + u * table[e[5, i], f])
                        + high1 * ((_ONE - u) * table[e[6, i], f] + u * table[e[7, i], f])
                    )


@_inlined
def _dot(table: Floats, entry: np.uint32, grad: Floats, n: int, first: int, lanes: tuple[int, ...]) -> np.float32:
    total = np.float32(0)
    for f in range(len(lanes)):
        total += table[entry, f] * grad[n, first + f]
    return total


@_parallel
def _backward_points(
    points: Floats, tables: Floats, inverse: Floats, lanes: tuple[int, ...], grad_features: Floats, grad_points: Floats
) -> None:
    width = len(lanes)
    mask = np.uint32(tables.shape[1] - 1)
    for block in prange((len(points) + BLOCK - 1) // BLOCK):
        start = block * BLOCK
        count = min(len(points) - start, BLOCK)
        e = np.empty((8, BLOCK), np.uint32)
        xyz, fraction = np.empty((3, BLOCK), np.float32), np.empty((3, BLOCK), np.float32)
        stage(points, start, count, xyz)
        for level in range(len(tables)):
            t, g, k, scale = tables[level], grad_features, level * width, inverse[level]
            locate(xyz, count, scale, mask, e, fraction)
            for i in range(count):
                n = start + i
                _, du, dv, dw = trilinear(
                    _dot(t, e[0, i], g, n, k, lanes),
                    _dot(t, e[1, i], g, n, k, lanes),
                    _dot(t, e[2, i], g, n, k, lanes),
                    _dot(t, e[3, i], g, n, k, lanes),
                    _dot(t, e[4, i], g, n, k, lanes),
                    _dot(t, e[5, i], g, n, k, lanes),
                    _dot(t, e[6, i], g, n, k, lanes),
                    _dot(t, e[7, i], g, n, k, lanes),
                    fraction[0, i],
                    fraction[1, i],
                    fraction[2, i],
                )
                grad_points[n, 0] += du * scale
                grad_points[n, 1] += dv * scale
                grad_points[n, 2] += dw * scale


@_inlined
def _scatter(
    table: Floats, touched: Flags, e: Entries, fraction: Floats, count: int, lanes: tuple[int, ...], grad: Floats, n: int, first: int
) -> None:
    """Adds the gradient of a block of points to one level's table: rows from n on and columns from `first` on of `grad`."""
    for corner in range(8):
        for i in range(count):
            touched[e[corner, i] // RUN] = 1
    for i in range(count):
        u, v, w = fraction[0, i], fraction[1, i], fraction[2, i]
        low, high = (_ONE - v) * (_ONE - w), (_ONE - v) * w
        low1, high1 = v * (_ONE - w), v * w
        for f in range(len(lanes)):
            right = u * grad[n + i, first + f]
            left = grad[n + i, first + f] - right
            table[e[0, i], f] += low * left
            table[e[1, i], f] += low * right
            table[e[2, i], f] += low1 * left
            table[e[3, i], f] += low1 * right
            table[e[4, i], f] += high * left
            table[e[5, i], f] += high * right
            table[e[6, i], f] += high1 * left
            table[e[7, i], f] += high1 * right


@_parallel
def _backward_tables(
    points: Floats, inverse: Floats, lanes: tuple[int, ...], grad_features: Floats, grad_tables: Floats, touched: Flags, workers: int
) -> None:
    width = len(lanes)
    mask = np.uint32(grad_tables.shape[1] - 1)
    for worker in prange(workers):
        e = np.empty((8, BLOCK), np.uint32)
        xyz, fraction = np.empty((3, BLOCK), np.float32), np.empty((3, BLOCK), np.float32)
        for level in range(worker, len(grad_tables), workers):  # interleaved: fine levels miss the cache more often
            for start in range(0, len(points), BLOCK):
                count = min(len(points) - start, BLOCK)
                stage(points, start, count, xyz)
                locate(xyz, count, inverse[level], mask, e, fraction)
                _scatter(grad_tables[level], touched[level], e, fraction, count, lanes, grad_features, start, level * width)


@_inlined
def _any_nonzero(grad: Floats) -> bool:
    count = np.int32(0)
    for i in range(len(grad)):
        count += np.int32(grad[i] != 0)
    return count > 0


@_inlined
def _adam_run(x: Floats, grad: Floats, m: Floats, v: Floats, rates: tuple[np.float32, ...]) -> None:
    """Adam on neighbouring numbers. It is computed for all and kept where the gradient is not zero, so that the loop vectorises."""
    step_size, beta1, beta2, correction, eps = rates
    one_minus1, one_minus2 = _ONE - beta1, _ONE - beta2
    for i in range(len(x)):
        g, old_m, old_v, old_x = grad[i], m[i], v[i], x[i]
        new_m, new_v = beta1 * old_m + one_minus1 * g, beta2 * old_v + one_minus2 * g * g
        new_x = old_x - step_size * new_m / (np.sqrt(new_v) * correction + eps)
        touched = g != 0
        m[i] = new_m if touched else old_m
        v[i] = new_v if touched else old_v
        x[i] = new_x if touched else old_x
        grad[i] = 0


@_parallel
def _adam_step(x: Floats, grad: Floats, m: Floats, v: Floats, touched: Flags, rates: tuple[np.float32, ...]) -> None:
    width = len(x) // len(touched)
    for block in prange((len(touched) + ADAM_BLOCK - 1) // ADAM_BLOCK):
        for run in range(block * ADAM_BLOCK, min(len(touched), (block + 1) * ADAM_BLOCK)):
            start, end = run * width, (run + 1) * width
            marked, touched[run] = touched[run], 0
            if marked == 0 or not _any_nonzero(grad[start:end]):
                continue
            for first in range(start, end, ADAM_LINE):
                line = slice(first, min(end, first + ADAM_LINE))
                if _any_nonzero(grad[line]):
                    _adam_run(x[line], grad[line], m[line], v[line], rates)


def _array(tensor: Tensor) -> Floats:
    """A tensor as an array that shares its memory."""
    return tensor.detach().numpy()


def _inverse(cells: Tensor) -> Floats:
    return np.float32(1) / _array(cells)


def forward(points: Tensor, tables: Tensor, cells: Tensor) -> Tensor:
    """Features (N, L * F), trilinear in each cell."""
    levels, _, width = tables.shape
    features = torch.empty(len(points), levels * width)
    _forward(_array(points), _array(tables), _inverse(cells), (0,) * width, _array(features))
    return features


def backward_tables(points: Tensor, cells: Tensor, grad_features: Tensor, grad_tables: Tensor, touched: Tensor | None = None) -> None:
    """Adds the gradient by the tables to `grad_tables` (L, S, F), given that by the features (N, L * F). Marks the places in `touched`."""
    levels, _, width = grad_tables.shape
    workers = min(levels, numba.get_num_threads())
    tables, flags = _array(grad_tables), (touched_runs(grad_tables) if touched is None else touched).numpy()
    _backward_tables(_array(points), _inverse(cells), (0,) * width, _array(grad_features), tables, flags, workers)


def backward_points(points: Tensor, tables: Tensor, cells: Tensor, grad_features: Tensor) -> Tensor:
    """The gradient by the points (N, 3), given that by the features (N, L * F)."""
    grad_points = torch.zeros_like(points)
    _backward_points(_array(points), _array(tables), _inverse(cells), (0,) * tables.shape[2], _array(grad_features), _array(grad_points))
    return grad_points


def adam_step(tables: Tensor, grad: Tensor, m: Tensor, v: Tensor, touched: Tensor | None, rates: Rates) -> None:
    """Adam, in place, on the numbers with a gradient other than zero, in the `touched` runs if given. Both are zero afterwards."""
    x, g, first, second = (_array(tensor).reshape(-1) for tensor in (tables, grad, m, v))
    flags = (touched_runs(tables).fill_(1) if touched is None else touched).numpy().reshape(-1)
    _adam_step(x, g, first, second, flags, single(rates))


def single(rates: Rates) -> tuple[np.float32, ...]:
    """The rates in single precision, for the kernels."""
    return tuple(np.float32(rate) for rate in rates)


class Tables:
    """The tables of a map update as arrays, so that each call is one kernel without work in Python."""

    def __init__(self, tables: Tensor, grad: Tensor, m: Tensor, v: Tensor, touched: Tensor, cells: Tensor) -> None:
        self._tables, self._grad, self._inverse, self._lanes = _array(tables), _array(grad), _inverse(cells), (0,) * tables.shape[2]
        self._touched, self._workers = touched.numpy(), min(tables.shape[0], numba.get_num_threads())
        self._flat = [array.reshape(-1) for array in (self._tables, self._grad, _array(m), _array(v))]

    def forward(self, points: Floats, features: Floats) -> None:
        """Fills features (N, L * F) at points (N, 3)."""
        _forward(points, self._tables, self._inverse, self._lanes, features)

    def backward(self, points: Floats, grad_features: Floats) -> None:
        """Adds the gradient by the tables, given that by the features (N, L * F)."""
        _backward_tables(points, self._inverse, self._lanes, grad_features, self._grad, self._touched, self._workers)

    def adam(self, learning_rate: float, step: int) -> None:
        """One step of `sparse_adam`."""
        x, grad, m, v = self._flat
        _adam_step(x, grad, m, v, self._touched.reshape(-1), single(adam_rates(learning_rate, *BETAS, EPS, step)))
