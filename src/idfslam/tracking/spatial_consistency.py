"""Spatial consistency of matches: a rigid motion keeps the distance between any two points, so right matches keep each other's distances.

Second-order spatial compatibility after SC2-PCR (Chen et al., CVPR 2022); seeds by the leading eigenvector (Leordeanu and Hebert, 2005).
"""

import torch
from torch import Tensor

_POWER_STEPS = 10  # of the power iteration for the leading eigenvector; more: nothing, it has converged


@torch.no_grad()
def compatible_subsets(source: Tensor, target: Tensor, *, subsets: int, share: float, tolerance: float) -> Tensor:
    """For each of `subsets` seeds the `share` of the matches (M, 3), three at least, most compatible with it: indices (S, n).

    Two matches are compatible if the distance between their points differs by less than `tolerance` [m] in the two clouds; to the second
    order, by how many others are compatible with both. Seeds are those most compatible with all.
    """
    count = len(source)
    apart = (torch.cdist(source, source) - torch.cdist(target, target)).abs()
    compatible = (apart < tolerance).float()
    second_order = compatible * (compatible @ compatible)
    support = torch.ones(count, device=source.device)
    for _ in range(_POWER_STEPS):
        support = second_order @ support
        support = support / support.norm().clamp(min=1e-12)
    seeds = support.argsort(descending=True, stable=True)[:subsets]
    return second_order[seeds].topk(min(count, max(3, round(share * count))), dim=-1).indices
