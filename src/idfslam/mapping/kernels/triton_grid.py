# mypy: allow-untyped-defs
# The parameters of a Triton kernel are pointers and compile-time constants; Python has no types for them.
"""Multi-resolution hash grid on CUDA in Triton: the contract of `torch_grid`, float32 only.

One program processes a block of points. The features of an entry are padded to a power of two, so every memory access is a tile (points,
features). The tables' gradient is summed by atomic additions in no fixed order, so sums differ in the last bits from run to run.
"""

import torch
import triton
import triton.language as tl
from torch import Tensor

from idfslam.mapping.kernels.torch_grid import Rates

BLOCK = 128  # points a program
ADAM_BLOCK = 1024  # numbers a program

_Y8 = tl.constexpr((2_654_435_761 * 8 + 2**31) % 2**32 - 2**31)  # eight times the primes of the hash as int32; products wrap around
_Z8 = tl.constexpr((805_459_861 * 8 + 2**31) % 2**32 - 2**31)


@triton.jit
def _load_points(points, n, inside):
    return tl.load(points + 3 * n, inside, 0.0), tl.load(points + 3 * n + 1, inside, 0.0), tl.load(points + 3 * n + 2, inside, 0.0)


@triton.jit
def _locate(x, y, z, inverse):
    """The lower lattice vertex of a cell, and the position within the cell, 0..1."""
    x, y, z = x * inverse, y * inverse, z * inverse
    x_floor, y_floor, z_floor = tl.floor(x), tl.floor(y), tl.floor(z)
    return x_floor.to(tl.int32), y_floor.to(tl.int32), z_floor.to(tl.int32), x - x_floor, y - y_floor, z - z_floor


@triton.jit
def _entry(x, y, z, mask, corner: tl.constexpr):
    """The table entry of a corner, numbered with x changing fastest: `torch_grid.hash_vertices`."""
    x, y, z = x + corner % 2, y + corner // 2 % 2, z + corner // 4
    block = (x >> 1) * 8 ^ (y >> 1) * _Y8 ^ (z >> 1) * _Z8
    return (block ^ (x & 1) ^ (y & 1) << 1 ^ (z & 1) << 2) & mask


@triton.jit
def _side(fraction, upper: tl.constexpr):
    """The weight along one axis of the upper or the lower side of the cell."""
    return fraction if upper else 1.0 - fraction


@triton.jit
def _forward_kernel(
    points, tables, inverse, features, count, size, LEVELS: tl.constexpr, WIDTH: tl.constexpr, PADDED: tl.constexpr, BLOCK: tl.constexpr
):
    n = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    level = tl.program_id(1)
    inside, f = n < count, tl.arange(0, PADDED)
    tile = inside[:, None] & (f < WIDTH)[None, :]
    px, py, pz = _load_points(points, n.to(tl.int64), inside)
    x, y, z, u, v, w = _locate(px, py, pz, tl.load(inverse + level))
    table = tables + level.to(tl.int64) * size * WIDTH
    total = tl.zeros((BLOCK, PADDED), tl.float32)
    for corner in tl.static_range(8):
        weight = _side(u, corner % 2) * _side(v, corner // 2 % 2) * _side(w, corner // 4)
        offset = _entry(x, y, z, size - 1, corner).to(tl.int64)[:, None] * WIDTH + f[None, :]
        total += weight[:, None] * tl.load(table + offset, tile, 0.0)
    row = n.to(tl.int64)[:, None] * (LEVELS * WIDTH) + level * WIDTH
    tl.store(features + row + f[None, :], total, tile)


@triton.jit
def _backward_tables_kernel(
    points,
    inverse,
    grad_features,
    grad_tables,
    count,
    size,
    LEVELS: tl.constexpr,
    WIDTH: tl.constexpr,
    PADDED: tl.constexpr,
    BLOCK: tl.constexpr,
):
    n = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    level = tl.program_id(1)
    inside, f = n < count, tl.arange(0, PADDED)
    tile = inside[:, None] & (f < WIDTH)[None, :]
    px, py, pz = _load_points(points, n.to(tl.int64), inside)
    x, y, z, u, v, w = _locate(px, py, pz, tl.load(inverse + level))
    row = n.to(tl.int64)[:, None] * (LEVELS * WIDTH) + level * WIDTH
    grad = tl.load(grad_features + row + f[None, :], tile, 0.0)
    table = grad_tables + level.to(tl.int64) * size * WIDTH
    for corner in tl.static_range(8):
        weight = _side(u, corner % 2) * _side(v, corner // 2 % 2) * _side(w, corner // 4)
        offset = _entry(x, y, z, size - 1, corner).to(tl.int64)[:, None] * WIDTH + f[None, :]
        tl.atomic_add(table + offset, weight[:, None] * grad, tile, sem="relaxed")


@triton.jit
def _backward_points_kernel(
    points,
    tables,
    inverse,
    grad_features,
    grad_points,
    count,
    size,
    LEVELS: tl.constexpr,
    WIDTH: tl.constexpr,
    PADDED: tl.constexpr,
    BLOCK: tl.constexpr,
):
    n = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside, f = n < count, tl.arange(0, PADDED)
    tile = inside[:, None] & (f < WIDTH)[None, :]
    n = n.to(tl.int64)
    px, py, pz = _load_points(points, n, inside)
    gx, gy, gz = tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32)
    table = tables
    for level in range(LEVELS):
        scale = tl.load(inverse + level)
        x, y, z, u, v, w = _locate(px, py, pz, scale)
        grad = tl.load(grad_features + n[:, None] * (LEVELS * WIDTH) + level * WIDTH + f[None, :], tile, 0.0)
        for corner in tl.static_range(8):
            wu, wv, ww = _side(u, corner % 2), _side(v, corner // 2 % 2), _side(w, corner // 4)
            offset = _entry(x, y, z, size - 1, corner).to(tl.int64)[:, None] * WIDTH + f[None, :]
            pull = tl.sum(tl.load(table + offset, tile, 0.0) * grad, 1) * scale
            gx += wv * ww * pull * (2 * (corner % 2) - 1)
            gy += wu * ww * pull * (2 * (corner // 2 % 2) - 1)
            gz += wu * wv * pull * (2 * (corner // 4) - 1)
        table += size * WIDTH
    tl.store(grad_points + 3 * n, gx, inside)
    tl.store(grad_points + 3 * n + 1, gy, inside)
    tl.store(grad_points + 3 * n + 2, gz, inside)


@triton.jit
def _adam_kernel(x, grad, m, v, count, step_size, beta1, beta2, correction, eps, BLOCK: tl.constexpr):
    i = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    g = tl.load(grad + i, i < count, 0.0)
    touched = g != 0  # also false beyond the end; memory of the rest is neither read nor written
    new_m = beta1 * tl.load(m + i, touched, 0.0) + (1 - beta1) * g
    new_v = beta2 * tl.load(v + i, touched, 0.0) + (1 - beta2) * g * g
    tl.store(m + i, new_m, touched)
    tl.store(v + i, new_v, touched)
    tl.store(x + i, tl.load(x + i, touched, 0.0) - step_size * new_m / (tl.sqrt(new_v) * correction + eps), touched)
    tl.store(grad + i, tl.zeros_like(g), touched)


def _shape(tables: Tensor) -> dict[str, int]:
    levels, _, width = tables.shape
    return {"LEVELS": levels, "WIDTH": width, "PADDED": triton.next_power_of_2(width), "BLOCK": BLOCK}


def forward(points: Tensor, tables: Tensor, cells: Tensor) -> Tensor:
    """Features (N, L * F), trilinear in each cell."""
    levels, size, width = tables.shape
    features = points.new_empty(len(points), levels * width)
    if len(points):
        blocks = (triton.cdiv(len(points), BLOCK), levels)
        _forward_kernel[blocks](points, tables, 1 / cells, features, len(points), size, **_shape(tables))
    return features


def backward_tables(points: Tensor, cells: Tensor, grad_features: Tensor, grad_tables: Tensor, touched: Tensor | None = None) -> None:
    """Adds the gradient by the tables to `grad_tables` (L, S, F), given that by the features (N, L * F)."""
    levels, size, _ = grad_tables.shape
    if len(points):
        blocks = (triton.cdiv(len(points), BLOCK), levels)
        _backward_tables_kernel[blocks](points, 1 / cells, grad_features, grad_tables, len(points), size, **_shape(grad_tables))


def backward_points(points: Tensor, tables: Tensor, cells: Tensor, grad_features: Tensor) -> Tensor:
    """The gradient by the points (N, 3), given that by the features (N, L * F)."""
    grad_points = torch.empty_like(points)
    if len(points):
        blocks = (triton.cdiv(len(points), BLOCK),)
        _backward_points_kernel[blocks](
            points, tables, 1 / cells, grad_features, grad_points, len(points), tables.shape[1], **_shape(tables)
        )
    return grad_points


def adam_step(tables: Tensor, grad: Tensor, m: Tensor, v: Tensor, touched: Tensor | None, rates: Rates) -> None:
    """Adam, in place, on the numbers with a gradient other than zero. `grad` is zero afterwards."""
    blocks = (triton.cdiv(tables.numel(), ADAM_BLOCK),)
    _adam_kernel[blocks](tables, grad, m, v, tables.numel(), *rates, BLOCK=ADAM_BLOCK)
