"""Correspondences by nearest neighbours in feature space (Sec. V, V-A): both ways, ratio weights, spread over the image."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.compute.backend import pick

_SIMILARITIES = 1 << 19  # held at a time, so that they stay near in the caches

Features = Callable[[Tensor], Tensor]
"""Pixels (N,), flat indices -> their unit features (N, C)."""


def features_in(image: Tensor) -> Features:
    """The pixels of an image of unit features (C, H, W)."""
    rows = image.flatten(1).mT
    return lambda pixels: rows[pixels]


@dataclass(frozen=True)
class Matches:
    """M correspondences between the pixels of a frame and of a keyframe, as indices into the flattened images."""

    frame: Tensor  # (M,) int64
    keyframe: Tensor  # (M,) int64
    weight: Tensor  # (M,) in [0, 1], differentiable in the features

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, chosen: Tensor) -> "Matches":
        return Matches(self.frame[chosen], self.keyframe[chosen], self.weight[chosen])


@torch.no_grad()
def nearest(queries: Tensor, targets: Tensor) -> Tensor:
    """The two targets (M, C), M >= 2, nearest in cosine to each of the queries (N, C), unit rows: indices (N, 2), the nearest first.

    Memory is bounded: a chunk of queries at a time.
    """
    rows = max(1, _SIMILARITIES // len(targets))
    similarity = queries.new_empty(min(rows, len(queries)), len(targets))  # used again by each chunk: fresh memory is slow
    return torch.cat([two_largest(torch.mm(chunk, targets.mT, out=similarity[: len(chunk)])) for chunk in queries.split(rows)])


def two_largest(values: Tensor) -> Tensor:
    """The places (N, 2) of the two largest in each row of values (N, M), the largest first."""
    return pick(values, compiled=compiled_two_largest, plain=plain_two_largest)(values)


def plain_two_largest(values: Tensor) -> Tensor:
    """`two_largest` in torch, on any device."""
    return values.topk(2, dim=-1).indices


def compiled_two_largest(values: Tensor) -> Tensor:
    """`two_largest` by Numba, on the CPU."""
    from idfslam.tracking.kernels import numba_tracking

    indices = torch.empty(len(values), 2, dtype=torch.int64)
    numba_tracking.two_largest(values.numpy(), indices.numpy())
    return indices


def ratio_weights(queries: Tensor, targets: Tensor, neighbours: Tensor) -> Tensor:
    """w = 1 - d1/d2 with d = 1 - cosine, of each query's two neighbours (N, 2); (N,), differentiable [31]."""
    distance = 1 - (queries[:, None] * targets[neighbours]).sum(-1)
    first, second = distance.clamp(min=1e-6).unbind(-1)
    return (1 - first / second).clamp(min=0)


def lattice(valid: Tensor, stride: int) -> Tensor:
    """Flat indices of the valid pixels (H, W) on every `stride`-th row and column."""
    flat = torch.arange(valid.numel(), device=valid.device).view_as(valid)[stride // 2 :: stride, stride // 2 :: stride]
    return flat[valid.flatten()[flat]]


def _directed(queries: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
    """For features (N, C) the nearest of `targets` (M, C) by index, and the ratio weights."""
    neighbours = nearest(queries.detach(), targets.detach())
    return neighbours[:, 0], ratio_weights(queries, targets, neighbours)


def match(
    frame: Features,
    keyframe: Features,
    frame_valid: Tensor,
    keyframe_valid: Tensor,
    *,
    query_stride: int = 1,
    target_stride: int = 1,
    mutual: bool = False,
) -> Matches:
    """Nearest neighbours in feature space among the pixels with depth (H, W), from each image to the other.

    Strides thin the lattice of pixels that ask and of pixels that may answer; 1 and 1 is the paper's full search.
    `mutual` keeps the frame's matches whose answer, asked back, returns to within one query of where it came from, instead of
    adding the keyframe's own matches. Empty if either image has fewer than two candidates.
    """
    width = frame_valid.shape[1]
    frame_targets, keyframe_targets = lattice(frame_valid, target_stride), lattice(keyframe_valid, target_stride)
    queries = lattice(frame_valid, query_stride)
    if min(len(frame_targets), len(keyframe_targets), len(queries)) < 2:
        none = frame_targets[:0]
        return Matches(none, none, torch.zeros(0, device=none.device))
    frame_field, keyframe_field = frame(frame_targets), keyframe(keyframe_targets)
    found, weight = _directed(frame(queries), keyframe_field)
    answers = keyframe_targets[found]
    if mutual:
        asked, place = found.unique(return_inverse=True)  # some answer several queries
        returned, back_weight = _directed(keyframe_field[asked], frame_field)
        back = frame_targets[returned][place]
        near = torch.maximum((back // width - queries // width).abs(), (back % width - queries % width).abs()) <= max(
            query_stride, target_stride
        )
        return Matches(queries, answers, torch.minimum(weight, back_weight[place]))[near]
    others = lattice(keyframe_valid, query_stride)
    found, other_weight = _directed(keyframe(others), frame_field)
    return Matches(torch.cat([queries, frame_targets[found]]), torch.cat([answers, others]), torch.cat([weight, other_weight]))


def spread(matches: Matches, shape: tuple[int, int], *, limit: int, grid: int) -> Matches:
    """The best `limit` = K matches by weight, at most K / grid^2 (rounded up) of them from a cell of the frame's image (H, W) (Sec. V-A).

    `grid` = 1 is [31]'s plain top K.
    """
    height, width = shape
    row, column = matches.frame // width * grid // height, matches.frame % width * grid // width
    best = matches.weight.detach().argsort(descending=True, stable=True)
    cell = (row * grid + column)[best]
    by_cell = cell.argsort(stable=True)  # cells together, each in order of weight
    counts = torch.bincount(cell, minlength=grid * grid)
    first = counts.cumsum(0) - counts
    rank = torch.empty_like(cell)
    rank[by_cell] = torch.arange(len(cell), device=cell.device) - first[cell[by_cell]]
    return matches[best[rank < math.ceil(limit / grid**2)][:limit]]
