"""The grid encoding on the backend of its tensors (Numba, Triton or plain torch) or on another one that the caller names."""

from types import ModuleType
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from idfslam.compute.backend import Backend, backend_of
from idfslam.mapping.kernels import torch_grid


def grid_encode(
    points: Tensor,
    tables: Tensor,
    cells: Tensor,
    *,
    backend: Backend | None = None,
    accumulate_into: Tensor | None = None,
) -> Tensor:
    """Features (N, L * F), level-major, of points (N, 3) [m] in tables (L, S, F) with lattice cells (L,) [m]; float32.

    S is a power of two. Features are trilinear between the hashed vertices of each level's unbounded lattice (Mueller et al. 2022, Sec. 3);
    `torch.cat([tables, tables], 1)` is a table of twice the size with exactly the same features. Differentiable once by points and tables.

    With `accumulate_into` (L, S, F) the gradient by the tables is added to that buffer in place, and autograd returns none for them. This
    saves allocating and adding a whole table in each call. The tables must still require a gradient. `sparse_adam` zeroes the buffer.
    Raises ValueError for shapes, dtypes and devices outside the contract.
    """
    kernels = _kernels(points.device, backend)
    _check(points, tables, cells, any_dtype=kernels is torch_grid)
    if accumulate_into is not None and (accumulate_into.shape != tables.shape or not accumulate_into.is_contiguous()):
        raise ValueError(f"accumulate_into has shape {tuple(accumulate_into.shape)}, expected contiguous {tuple(tables.shape)}")
    return _GridEncode.apply(points.contiguous(), tables, cells, kernels, accumulate_into)


@torch.no_grad()
def grid_scatter(
    points: Tensor,
    cells: Tensor,
    grad_features: Tensor,
    into: Tensor,
    *,
    touched: Tensor | None = None,
    backend: Backend | None = None,
) -> None:
    """Adds to `into` (L, S, F) the tables' gradient for grad_features (N, L * F) at points (N, 3), outside autograd.

    touched: marks for `sparse_adam`, made by `touched_runs`.
    """
    kernels = _kernels(points.device, backend)
    _check(points, into, cells, any_dtype=kernels is torch_grid)
    kernels.backward_tables(points.contiguous(), cells, grad_features.contiguous(), into, touched)


@torch.no_grad()
def sparse_adam(
    tables: Tensor,
    grad: Tensor,
    m: Tensor,
    v: Tensor,
    *,
    step: int,
    learning_rate: float,
    betas: tuple[float, float] = torch_grid.BETAS,
    eps: float = torch_grid.EPS,
    touched: Tensor | None = None,
    backend: Backend | None = None,
) -> None:
    """One step of Adam, in place, on the numbers with a gradient other than zero; tensors (L, S, F). `grad` is zero afterwards.

    Entries that no sample touched keep value and moments (lazy Adam), and their memory is not written. `step` counts from 1 for the tables
    as a whole. With the default betas a number that is first touched late still moves by the learning rate: (1 - 0.9) / sqrt(1 - 0.99) = 1.
    touched: marks of `grid_scatter` for all entries with a gradient. Without them the whole table is searched.
    """
    if not (tables.shape == grad.shape == m.shape == v.shape):
        raise ValueError(f"shapes differ: tables {tuple(tables.shape)}, grad {tuple(grad.shape)}, m {tuple(m.shape)}, v {tuple(v.shape)}")
    if not all(tensor.is_contiguous() for tensor in (tables, grad, m, v)):
        raise ValueError("tables, grad, m and v must be contiguous")
    kernels = _kernels(tables.device, backend)
    kernels.adam_step(tables, grad, m, v, touched, torch_grid.adam_rates(learning_rate, *betas, eps, step))
    torch.autograd.graph.increment_version(tables)  # a graph that still needs the old values must fail, not use the new ones


def load(v: Tensor) -> Tensor:
    """Share (L,) of each level's entries that `sparse_adam` ever updated, from its second moments (L, S, F).

    It is near 1 - exp(-k) if k times as many lattice vertices as entries are in use: 0.63 means as many vertices as entries. A table that
    is doubled together with its moments keeps its load. Set the moments to zero to measure again.
    """
    return (v > 0).any(-1).float().mean(-1)


class _GridEncode(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, tables: Tensor, cells: Tensor, kernels: ModuleType, accumulate_into: Tensor | None) -> Tensor:
        ctx.kernels, ctx.accumulate_into, ctx.shape = kernels, accumulate_into, tables.shape
        ctx.save_for_backward(points, cells, tables if ctx.needs_input_grad[0] else None)
        return kernels.forward(points, tables, cells)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_features: Tensor) -> tuple[Tensor | None, ...]:
        points, cells, tables = ctx.saved_tensors
        grad_features = grad_features.contiguous()
        grad_points = grad_tables = None
        if ctx.needs_input_grad[0]:
            grad_points = ctx.kernels.backward_points(points, tables, cells, grad_features)
        if ctx.needs_input_grad[1]:
            target = grad_features.new_zeros(ctx.shape) if ctx.accumulate_into is None else ctx.accumulate_into
            ctx.kernels.backward_tables(points, cells, grad_features, target)
            grad_tables = target if ctx.accumulate_into is None else None
        return grad_points, grad_tables, None, None, None


def _kernels(device: torch.device, backend: Backend | None) -> ModuleType:
    """The module with the kernels. It is imported on demand: importing Numba or Triton takes a second."""
    chosen = backend or backend_of(device)
    if chosen is Backend.NUMBA:
        from idfslam.mapping.kernels import numba_grid

        return numba_grid
    if chosen is Backend.TRITON:
        from idfslam.mapping.kernels import triton_grid

        return triton_grid
    return torch_grid


def _check(points: Tensor, tables: Tensor, cells: Tensor, *, any_dtype: bool) -> None:
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points have shape {tuple(points.shape)}, expected (N, 3)")
    if tables.ndim != 3 or tables.shape[1] & (tables.shape[1] - 1) or tables.shape[1] == 0:
        raise ValueError(f"tables have shape {tuple(tables.shape)}, expected (levels, a power of two, features)")
    if cells.shape != tables.shape[:1]:
        raise ValueError(f"cells have shape {tuple(cells.shape)}, expected one for each of {tables.shape[0]} levels")
    if not (tables.is_contiguous() and cells.is_contiguous()):
        raise ValueError("tables and cells must be contiguous")
    if not any_dtype and not (points.dtype == tables.dtype == cells.dtype == torch.float32):
        raise ValueError(f"points, tables, cells are {points.dtype}, {tables.dtype}, {cells.dtype}, expected float32")
    if not points.device == tables.device == cells.device:
        raise ValueError(f"points, tables, cells are on {points.device}, {tables.device}, {cells.device}, expected one device")
