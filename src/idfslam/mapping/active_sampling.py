"""Active sampling (Sec. IV-A, from iMAP): an image is divided into cells, and pixels are drawn in proportion to the cells' losses.

For the pose (Sec. IV-B) the shares are inverted: more pixels are drawn where the map is already good.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.compute.backend import pick

_LEAST_LOSS = 0.01  # [1] least loss of a cell, as a share of the mean loss. More: pixels are drawn more evenly. Chosen by hand


@dataclass(frozen=True)
class CellPixels:
    """The pixels of an image that may be drawn, sorted by cell. It is built once for an image and takes 4 bytes a pixel."""

    order: Tensor  # (P,) int32 v * width + u, sorted by cell
    starts: Tensor  # (cells^2,) index in `order` of each cell's first pixel
    counts: Tensor  # (cells^2,) number of pixels of each cell
    height: int
    width: int
    cells: int


def cell_of(uv: Tensor, height: int, width: int, cells: int) -> Tensor:
    """The cell (N,), counted row by row, of integer pixels uv (N, 2)."""
    return (uv[:, 1] * cells // height) * cells + uv[:, 0] * cells // width


def group_pixels(allowed: Tensor, cells: int) -> CellPixels:
    """Sorts the pixels with `allowed` (H, W) bool, such as those with depth, into cells x cells cells."""
    return pick(allowed, compiled=compiled_group_pixels, plain=plain_group_pixels)(allowed, cells)


def plain_group_pixels(allowed: Tensor, cells: int) -> CellPixels:
    """`group_pixels` in torch, on any device."""
    height, width = allowed.shape
    v, u = allowed.nonzero(as_tuple=True)
    cell = cell_of(torch.stack([u, v], -1), height, width, cells)
    order = cell.argsort(stable=True)
    counts = torch.bincount(cell, minlength=cells * cells)
    return CellPixels((v * width + u)[order].int(), counts.cumsum(0) - counts, counts, height, width, cells)


def compiled_group_pixels(allowed: Tensor, cells: int) -> CellPixels:
    """`group_pixels` by Numba, on the CPU: a counting sort, which is faster than a general one."""
    from idfslam.mapping.kernels import numba_rays

    height, width = allowed.shape
    order, counts = torch.empty(allowed.numel(), dtype=torch.int32), torch.empty(cells * cells, dtype=torch.int64)
    total = numba_rays.group_pixels(allowed.numpy(), cells, order.numpy(), counts.numpy())
    return CellPixels(order[:total].clone(), counts.cumsum(0) - counts, counts, height, width, cells)


def initial_cell_losses(cells: int, device: torch.device | str = "cpu") -> Tensor:
    """Equal losses (cells, cells), with which pixels are drawn evenly at first."""
    return torch.ones(cells, cells, device=device)


def update_cell_losses(cell_losses: Tensor, uv: Tensor, per_ray: Tensor, height: int, width: int) -> Tensor:
    """The mean loss (cells, cells) of each cell, from the losses per_ray (N,) of pixels uv (N, 2). A cell without pixels keeps its loss."""
    cells = cell_losses.shape[0]
    cell = cell_of(uv, height, width, cells)
    counts = torch.bincount(cell, minlength=cells * cells)
    sums = cell_losses.new_zeros(cells * cells).index_add_(0, cell, per_ray.to(cell_losses.dtype))
    means = (sums / counts.clamp(min=1)).view(cells, cells)
    return torch.where(counts.view(cells, cells) > 0, means, cell_losses)


def cell_shares(cell_losses: Tensor, *, invert: bool = False) -> Tensor:
    """Shares (cells, cells) of the pixels, summing to 1: in proportion to the loss, or, with `invert`, to its reciprocal.

    A loss below a hundredth of the mean counts as that hundredth. So every cell gets pixels, and none gets all of them when inverted.
    """
    mean = cell_losses.mean()
    if mean <= 0:
        return torch.full_like(cell_losses, 1 / cell_losses.numel())
    losses = cell_losses.clamp(min=_LEAST_LOSS * float(mean))
    weights = 1 / losses if invert else losses
    return weights / weights.sum()


def allot(shares: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """The number of pixels (cells^2,) of each cell: its share of `count`, rounded up or down at random so that they sum to `count`."""
    offset = torch.rand((), generator=generator, device=shares.device, dtype=torch.float64)
    ends = shares.flatten().double().cumsum(0)
    passed = (ends / ends[-1] * count - offset).ceil().clamp(0, count)  # draws k with k + offset below a cell's end
    return passed.diff(prepend=passed.new_zeros(1)).long()


def draw_pixels(pixels: CellPixels, shares: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Draws `count` pixels (count, 2) int64 (u, v) with replacement: cells by `shares` (cells, cells), pixels evenly within a cell.

    Cells without an allowed pixel get none. An image without an allowed pixel gives (0, 2).
    """
    possible = shares.flatten() * (pixels.counts > 0)
    if not bool((possible > 0).any()):
        return torch.zeros(0, 2, dtype=torch.int64, device=shares.device)
    cell = torch.repeat_interleave(allot(possible, count, generator))
    chance = torch.rand(count, generator=generator, device=shares.device)
    within = (chance * pixels.counts[cell]).long().clamp(max=pixels.counts[cell] - 1)
    flat = pixels.order[pixels.starts[cell] + within].long()
    return torch.stack([flat % pixels.width, flat // pixels.width], -1)
