"""Matches of pixels by nearest neighbours in feature space (Sec. V, V-A): in both directions, weighted by ratios, in grid buckets."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.compute.backend import pick

_SIMILARITIES = 1 << 19  # similarities computed at a time. More: they no longer fit the caches. Chosen by hand

Features = Callable[[Tensor], Tensor]
"""Flat indices of pixels (N,) -> their unit features (N, C)."""


def features_in(image: Tensor) -> Features:
    """The lookup of features in an image of unit features (C, H, W)."""
    rows = image.flatten(1).mT
    return lambda pixels: rows[pixels]


@dataclass(frozen=True)
class PixelMatches:
    """M matches between the pixels of a frame and of a keyframe, as indices into the flattened images."""

    frame: Tensor  # (M,) int64
    keyframe: Tensor  # (M,) int64
    weight: Tensor  # (M,) in [0, 1], differentiable in the features

    def __len__(self) -> int:
        return len(self.frame)

    def __getitem__(self, chosen: Tensor) -> "PixelMatches":
        return PixelMatches(self.frame[chosen], self.keyframe[chosen], self.weight[chosen])


@torch.no_grad()
def nearest(queries: Tensor, targets: Tensor) -> Tensor:
    """For each of the queries (N, C) the two of the targets (M, C), M >= 2, with the largest cosine: indices (N, 2), nearest first.

    All rows are unit vectors. Queries are processed in chunks, so memory is bounded.
    """
    rows = max(1, _SIMILARITIES // len(targets))
    similarity = queries.new_empty(min(rows, len(queries)), len(targets))  # shared by all chunks: fresh memory is slow
    return torch.cat([two_largest(torch.mm(chunk, targets.mT, out=similarity[: len(chunk)])) for chunk in queries.split(rows)])


def two_largest(values: Tensor) -> Tensor:
    """The indices (N, 2) of the two largest values in each row of values (N, M), the largest first."""
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
    """Weights (N,) w = 1 - d1 / d2 with d = 1 - cosine to each query's two neighbours (N, 2) [31]. Differentiable in the features."""
    distance = 1 - (queries[:, None] * targets[neighbours]).sum(-1)
    first, second = distance.clamp(min=1e-6).unbind(-1)
    return (1 - first / second).clamp(min=0)


def lattice(valid: Tensor, stride: int) -> Tensor:
    """Flat indices of the valid pixels (H, W) on every `stride`-th row and column."""
    flat = torch.arange(valid.numel(), device=valid.device).view_as(valid)[stride // 2 :: stride, stride // 2 :: stride]
    return flat[valid.flatten()[flat]]


def _directed(queries: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
    """For each of the features (N, C) the index of the nearest of `targets` (M, C), and the ratio weight."""
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
) -> PixelMatches:
    """Nearest neighbours in feature space among the pixels with depth (H, W), from each image to the other.

    The strides thin the lattices of query pixels and of target pixels; 1 and 1 is the paper's full search. `mutual` adds no matches from
    the keyframe to the frame. It keeps the frame's matches whose target's own nearest neighbour lies within one stride of the query.
    Without two candidates in each image there are no matches.
    """
    width = frame_valid.shape[1]
    frame_targets, keyframe_targets = lattice(frame_valid, target_stride), lattice(keyframe_valid, target_stride)
    queries = lattice(frame_valid, query_stride)
    if min(len(frame_targets), len(keyframe_targets), len(queries)) < 2:
        none = frame_targets[:0]
        return PixelMatches(none, none, torch.zeros(0, device=none.device))
    frame_features, keyframe_features = frame(frame_targets), keyframe(keyframe_targets)
    neighbour, weight = _directed(frame(queries), keyframe_features)
    matched = keyframe_targets[neighbour]
    if mutual:
        distinct, inverse = neighbour.unique(return_inverse=True)  # several queries may share a neighbour
        back_neighbour, back_weight = _directed(keyframe_features[distinct], frame_features)
        back = frame_targets[back_neighbour][inverse]
        offset = torch.maximum((back // width - queries // width).abs(), (back % width - queries % width).abs())
        near = offset <= max(query_stride, target_stride)
        return PixelMatches(queries, matched, torch.minimum(weight, back_weight[inverse]))[near]
    keyframe_queries = lattice(keyframe_valid, query_stride)
    neighbour, keyframe_weight = _directed(keyframe(keyframe_queries), frame_features)
    pixels = torch.cat([queries, frame_targets[neighbour]]), torch.cat([matched, keyframe_queries])
    return PixelMatches(*pixels, torch.cat([weight, keyframe_weight]))


def bucket(matches: PixelMatches, shape: tuple[int, int], *, limit: int, grid: int) -> PixelMatches:
    """Grid bucketing (Sec. V-A): the best K = `limit` matches by weight, at most K / grid^2 (rounded up) from each cell of the frame.

    shape: (H, W) of the frame's image. `grid` = 1 is the plain top K of [31].
    """
    height, width = shape
    row, column = matches.frame // width * grid // height, matches.frame % width * grid // width
    best = matches.weight.detach().argsort(descending=True, stable=True)
    cell = (row * grid + column)[best]
    by_cell = cell.argsort(stable=True)  # sorted by cell, and by weight within a cell
    counts = torch.bincount(cell, minlength=grid * grid)
    first = counts.cumsum(0) - counts
    rank = torch.empty_like(cell)
    rank[by_cell] = torch.arange(len(cell), device=cell.device) - first[cell[by_cell]]
    return matches[best[rank < math.ceil(limit / grid**2)][:limit]]
