"""Rigid registration of weighted correspondences (Sec. V): weighted Procrustes, made robust by random subsets [31]."""

from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.geometry import se3


@dataclass(frozen=True)
class ProcrustesFit:
    """An estimated transform and its inliers."""

    T_ab: Tensor  # (4, 4) float64, differentiable in points and weights
    inliers: Tensor  # (M,) bool
    rmse: float  # of the inliers' distances [m]; nan without inliers


def procrustes(source: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """The rigid T (..., 4, 4) float64 that minimises sum w |target - T source|^2; points (..., M, 3), weights (..., M).

    Closed form by SVD of the weighted covariance, reflections excluded; differentiable where its singular values differ.
    """
    source, target, weight = source.double(), target.double(), weight.double()
    share = (weight / weight.sum(-1, keepdim=True).clamp(min=1e-12))[..., None]
    source_mean, target_mean = (share * source).sum(-2), (share * target).sum(-2)
    covariance = (share * (target - target_mean[..., None, :])).mT @ (source - source_mean[..., None, :])
    U, _, Vt = torch.linalg.svd(covariance)
    sign = torch.ones_like(source_mean)
    sign[..., 2] = torch.det(U.detach() @ Vt.detach()).sign()
    R = U @ (sign[..., None] * Vt)
    t = target_mean - (R @ source_mean[..., None])[..., 0]
    bottom = torch.zeros_like(R[..., :1, :1]).expand(*R.shape[:-2], 1, 4) + R.new_tensor([0.0, 0, 0, 1])
    return torch.cat([torch.cat([R, t[..., None]], -1), bottom], -2)


def residuals(T_ab: Tensor, source: Tensor, target: Tensor) -> Tensor:
    """|target - T source| [m]: (..., M) for transforms (..., 4, 4) and points (M, 3)."""
    return (target.double() - se3.transform(T_ab, source.double())).norm(dim=-1)


def random_subsets(count: int, *, subsets: int, share: float, generator: torch.Generator) -> Tensor:
    """S = `subsets` random subsets of `count` matches, each a `share` of them and at least three: indices (S, n) [31]."""
    size = min(count, max(3, round(share * count)))
    return torch.rand(subsets, count, generator=generator).topk(size, dim=-1).indices


@torch.no_grad()
def best_subset(source: Tensor, target: Tensor, weight: Tensor, subsets: Tensor, *, truncation: float = 0.0) -> Tensor:
    """The subset (n,) of `subsets` (S, n) whose Procrustes has the least weighted residual over all matches [31].

    `truncation` [m] caps a match's residual, so that all outliers count the same; 0: no cap.
    """
    residual = residuals(procrustes(source[subsets], target[subsets], weight[subsets]), source, target)
    if truncation > 0:
        residual = residual.clamp(max=truncation)
    return subsets[(weight * residual).sum(-1).argmin()]


def register(
    source: Tensor,
    target: Tensor,
    weight: Tensor,
    subsets: Tensor,
    *,
    inlier_distance: float,
    truncation: float = 0.0,
    refits: int = 0,
) -> ProcrustesFit:
    """Robust T_ab from points `source` (M, 3) in b to points `target` (M, 3) in a [m] with weights (M,), M >= 3, with outliers among them.

    The best of the `subsets` (S, n) of the matches gives the transform. Each of `refits` rounds then repeats Procrustes on all inliers,
    which are the matches within `inlier_distance` [m]. Gradients flow through the best subset's fit and the refits.
    """
    chosen = best_subset(source, target, weight, subsets.to(weight.device), truncation=truncation)
    T_ab = procrustes(source[chosen], target[chosen], weight[chosen])
    for _ in range(refits):
        inliers = residuals(T_ab.detach(), source, target) < inlier_distance
        if int(inliers.sum()) < 3:
            break
        T_ab = procrustes(source[inliers], target[inliers], weight[inliers])
    return supported(T_ab, source, target, inlier_distance)


def supported(T_ab: Tensor, source: Tensor, target: Tensor, inlier_distance: float) -> ProcrustesFit:
    """A transform (4, 4) with its inliers: the matches of points (N, 3), (N, 3) that it brings within `inlier_distance` [m]."""
    distance = residuals(T_ab.detach(), source, target)
    inliers = distance < inlier_distance
    return ProcrustesFit(T_ab, inliers, float(distance[inliers].square().mean().sqrt()))
