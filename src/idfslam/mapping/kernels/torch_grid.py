"""Multi-resolution hash grid in plain torch: the reference that the Numba and Triton kernels are tested against.

The encoding is that of Mueller et al., "Instant Neural Graphics Primitives" (2022), Sec. 3, on unbounded space. The lattice of every level
is infinite, and its vertices are hashed into a table of S = 2^k entries. Unlike there, a block of 2 x 2 x 2 vertices is hashed at once to
neighbouring entries. With two features a cell's corners are then in 3.4 cache lines on average instead of 6.

The grid modules share one contract of four functions, `forward`, `backward_tables`, `backward_points` and `adam_step`, on `points` (N, 3)
[m], `tables` (L, S, F) and `cells` (L,) [m]. Features are level-major, (N, L * F). `touched` (L, S / RUN) uint8 marks the runs of entries
with a gradient, so that Adam need not search the whole table (Numba; the others ignore it). Any floating dtype works here. The other
implementations take float32.
"""

import math

import torch
from torch import Tensor

PRIMES = (1, 2_654_435_761, 805_459_861)  # Eq. 4 of the paper; the first is 1, so neighbours in x are neighbouring entries

RUN = 64  # entries that share a mark of `touched`. More: fewer marks, and more entries that are searched
BETAS, EPS = (0.9, 0.99), 1e-15  # of Adam on the tables


Rates = tuple[float, float, float, float, float]
"""A step of Adam, x -= step_size * m / (sqrt(v) * correction + eps): step size, betas, correction, eps."""


def adam_rates(learning_rate: float, beta1: float, beta2: float, eps: float, step: int) -> Rates:
    """The rates of a step, counted from 1."""
    return learning_rate / (1 - beta1**step), beta1, beta2, 1 / math.sqrt(1 - beta2**step), eps


def touched_runs(tables: Tensor) -> Tensor:
    """Marks (L, S / RUN) uint8 for tables (L, S, F), at least one for each level, all zero."""
    return torch.zeros(tables.shape[0], max(1, tables.shape[1] // RUN), dtype=torch.uint8, device=tables.device)


def hash_vertices(vertices: Tensor, size: int) -> Tensor:
    """Table entries (...) of integer lattice vertices (..., 3): the hash of a vertex's block, followed by three bits for the place in it.

    The low bits of a product do not depend on the high ones, so 64-bit integers give the same as uint32 with wrap-around. The entry is
    taken modulo a power of two. So a table that is doubled by repetition has the same value at the new entry as at the old one.
    """
    primes, places = (torch.tensor(numbers, device=vertices.device) for numbers in (PRIMES, (1, 2, 4)))
    x, y, z = ((vertices >> 1) * primes * 8 + (vertices & 1) * places).unbind(-1)
    return (x ^ y ^ z) & (size - 1)


def locate(points: Tensor, cells: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Entries (N, L, 8) of the corners of each point's cell, x changing fastest, and the position (N, L, 3) within the cell, 0..1."""
    position = points[:, None, :] * (1 / cells)[None, :, None]
    lower = position.detach().floor()
    steps = torch.arange(8, device=points.device)[:, None] >> torch.arange(3, device=points.device) & 1
    return hash_vertices(lower.long()[:, :, None, :] + steps, size), position - lower


def gather(tables: Tensor, entries: Tensor) -> Tensor:
    """The values (N, L, 8, F) of the tables at entries (N, L, 8)."""
    levels = torch.arange(tables.shape[0], device=tables.device)[None, :, None]
    return tables[levels, entries]


def axis_weights(fraction: Tensor) -> Tensor:
    """The factors (N, L, 8, 3) whose product over the last axis is the trilinear weight of each corner."""
    steps = (torch.arange(8, device=fraction.device)[:, None] >> torch.arange(3, device=fraction.device) & 1).bool()
    return torch.where(steps, fraction[:, :, None, :], 1 - fraction[:, :, None, :])


def forward(points: Tensor, tables: Tensor, cells: Tensor) -> Tensor:
    """Features (N, L * F), trilinear in each cell; differentiable by autograd."""
    entries, fraction = locate(points, cells, tables.shape[1])
    weights = axis_weights(fraction).prod(-1)
    return (weights[..., None] * gather(tables, entries)).sum(2).flatten(1)


def backward_tables(points: Tensor, cells: Tensor, grad_features: Tensor, grad_tables: Tensor, touched: Tensor | None = None) -> None:
    """Adds the gradient by the tables to `grad_tables` (L, S, F), given that by the features (N, L * F)."""
    levels, size, width = grad_tables.shape
    entries, fraction = locate(points, cells, size)
    weights = axis_weights(fraction).prod(-1)
    added = weights[..., None] * grad_features.reshape(-1, levels, 1, width)
    entries = entries + size * torch.arange(levels, device=points.device)[None, :, None]
    grad_tables.view(-1, width).index_add_(0, entries.flatten(), added.reshape(-1, width))


def backward_points(points: Tensor, tables: Tensor, cells: Tensor, grad_features: Tensor) -> Tensor:
    """The gradient by the points (N, 3), given that by the features (N, L * F)."""
    entries, fraction = locate(points, cells, tables.shape[1])
    factors = axis_weights(fraction)
    signs = torch.where(torch.arange(8, device=points.device)[:, None] >> torch.arange(3, device=points.device) & 1 == 1, 1.0, -1.0)
    others = torch.stack([factors[..., [1, 2]].prod(-1), factors[..., [0, 2]].prod(-1), factors[..., [0, 1]].prod(-1)], -1)
    slopes = signs.to(others.dtype) * others / cells[None, :, None, None]
    along = torch.einsum("nlcf,nlf->nlc", gather(tables, entries), grad_features.unflatten(1, (len(cells), -1)))
    return torch.einsum("nlc,nlcd->nd", along, slopes)


def adam_step(tables: Tensor, grad: Tensor, m: Tensor, v: Tensor, touched: Tensor | None, rates: Rates) -> None:
    """Adam, in place, on the numbers with a gradient other than zero. `grad` is zero afterwards."""
    step_size, beta1, beta2, correction, eps = rates
    moved = grad != 0
    m.copy_(torch.where(moved, beta1 * m + (1 - beta1) * grad, m))
    v.copy_(torch.where(moved, beta2 * v + (1 - beta2) * grad * grad, v))
    tables.sub_(torch.where(moved, step_size * m / (v.sqrt() * correction + eps), 0.0))
    grad.zero_()
