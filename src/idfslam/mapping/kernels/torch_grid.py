"""Multi-resolution hash grid in plain torch: the reference that the Numba and Triton kernels are tested against.

The encoding is that of Mueller et al., "Instant Neural Graphics Primitives" (2022), Sec. 3, on unbounded space: the lattice of every
level is infinite and its vertices are hashed into a table of S = 2^k entries, here eight at a time: the vertices of a block of 2 x 2 x 2
lie side by side, so that with two features a cell's corners are in 3.4 cache lines in the mean instead of 6. The grid modules share one
contract of four functions, `forward`, `backward_tables`, `backward_points` and `adam_step`, on `points` (N, 3) [m], `tables`
(L, S, F) and `cells` (L,) [m]; features come out level-major, (N, L * F). Where tables have a gradient `touched` (L, S / RUN) uint8
marks, so that Adam need not look everywhere (Numba; the others do without). Any floating dtype works here; the other implementations
take float32.
"""

import math

import torch
from torch import Tensor

PRIMES = (1, 2_654_435_761, 805_459_861)  # Eq. 4 of the paper; the first is 1 so that neighbours in x lie side by side

RUN = 64  # entries that share a mark
BETAS, EPS = (0.9, 0.99), 1e-15  # of Adam on the tables


Rates = tuple[float, float, float, float, float]
"""A step of Adam, x -= step_size * m / (sqrt(v) * correction + eps): step size, betas, correction, eps."""


def adam_rates(learning_rate: float, beta1: float, beta2: float, eps: float, step: int) -> Rates:
    """Those of a step, counted from 1."""
    return learning_rate / (1 - beta1**step), beta1, beta2, 1 / math.sqrt(1 - beta2**step), eps


def touched_runs(tables: Tensor) -> Tensor:
    """Marks (L, S / RUN) uint8 for tables (L, S, F), none set; at least one a level."""
    return torch.zeros(tables.shape[0], max(1, tables.shape[1] // RUN), dtype=torch.uint8, device=tables.device)


def hash_vertices(vertices: Tensor, size: int) -> Tensor:
    """Table entries (...) of integer lattice vertices (..., 3): the hash of its block, and behind it three bits for the place there.

    The low bits of a product do not depend on its high ones, so 64-bit integers give what uint32 with wrap-around gives. The entry is
    taken modulo a power of two: twice the table repeated twice holds the same value at the new entry as at the old one.
    """
    primes, places = (torch.tensor(numbers, device=vertices.device) for numbers in (PRIMES, (1, 2, 4)))
    x, y, z = ((vertices >> 1) * primes * 8 + (vertices & 1) * places).unbind(-1)
    return (x ^ y ^ z) & (size - 1)


def locate(points: Tensor, cells: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Entries (N, L, 8) of the corners around each point, x changing fastest, and the position (N, L, 3) within the cell, 0..1."""
    position = points[:, None, :] * (1 / cells)[None, :, None]
    lower = position.detach().floor()
    steps = torch.arange(8, device=points.device)[:, None] >> torch.arange(3, device=points.device) & 1
    return hash_vertices(lower.long()[:, :, None, :] + steps, size), position - lower


def gather(tables: Tensor, entries: Tensor) -> Tensor:
    """Values (N, L, 8, F) of the tables at the entries (N, L, 8)."""
    levels = torch.arange(tables.shape[0], device=tables.device)[None, :, None]
    return tables[levels, entries]


def axis_weights(fraction: Tensor) -> Tensor:
    """The factors (N, L, 8, 3) whose product over the last axis is the trilinear weight of each corner."""
    steps = (torch.arange(8, device=fraction.device)[:, None] >> torch.arange(3, device=fraction.device) & 1).bool()
    return torch.where(steps, fraction[:, :, None, :], 1 - fraction[:, :, None, :])


def forward(points: Tensor, tables: Tensor, cells: Tensor) -> Tensor:
    """Features (N, L * F), trilinear in each cell; differentiable by autograd as it stands."""
    entries, fraction = locate(points, cells, tables.shape[1])
    weights = axis_weights(fraction).prod(-1)
    return (weights[..., None] * gather(tables, entries)).sum(2).flatten(1)


def backward_tables(points: Tensor, cells: Tensor, grad_features: Tensor, grad_tables: Tensor, touched: Tensor | None = None) -> None:
    """Add the gradient by the tables to `grad_tables` (L, S, F), given that by the features (N, L * F)."""
    levels, size, width = grad_tables.shape
    entries, fraction = locate(points, cells, size)
    weights = axis_weights(fraction).prod(-1)
    added = weights[..., None] * grad_features.reshape(-1, levels, 1, width)
    entries = entries + size * torch.arange(levels, device=points.device)[None, :, None]
    grad_tables.view(-1, width).index_add_(0, entries.flatten(), added.reshape(-1, width))


def backward_points(points: Tensor, tables: Tensor, cells: Tensor, grad_features: Tensor) -> Tensor:
    """Gradient by the points (N, 3), given that by the features (N, L * F)."""
    entries, fraction = locate(points, cells, tables.shape[1])
    factors = axis_weights(fraction)
    signs = torch.where(torch.arange(8, device=points.device)[:, None] >> torch.arange(3, device=points.device) & 1 == 1, 1.0, -1.0)
    others = torch.stack([factors[..., [1, 2]].prod(-1), factors[..., [0, 2]].prod(-1), factors[..., [0, 1]].prod(-1)], -1)
    slopes = signs.to(others.dtype) * others / cells[None, :, None, None]
    along = torch.einsum("nlcf,nlf->nlc", gather(tables, entries), grad_features.unflatten(1, (len(cells), -1)))
    return torch.einsum("nlc,nlcd->nd", along, slopes)


def adam_step(tables: Tensor, grad: Tensor, m: Tensor, v: Tensor, touched: Tensor | None, rates: Rates) -> None:
    """Adam on the numbers whose gradient is not zero, in place; `grad` is zero afterwards."""
    step_size, beta1, beta2, correction, eps = rates
    moved = grad != 0
    m.copy_(torch.where(moved, beta1 * m + (1 - beta1) * grad, m))
    v.copy_(torch.where(moved, beta2 * v + (1 - beta2) * grad * grad, v))
    tables.sub_(torch.where(moved, step_size * m / (v.sqrt() * correction + eps), 0.0))
    grad.zero_()
