"""Spatial consistency of matches: a rigid motion preserves the distance between two points, so right matches preserve it too.

Second-order spatial compatibility as in SC2-PCR (Chen et al., CVPR 2022). Seeds come from the leading eigenvector (Leordeanu and Hebert,
2005).
"""

import torch
from torch import Tensor

_POWER_STEPS = 10  # steps of the power iteration for the leading eigenvector. More: nothing, it has converged. Chosen by hand


@torch.no_grad()
def consistent_subsets(source: Tensor, target: Tensor, *, subsets: int, share: float, tolerance: float) -> Tensor:
    """Subsets of consistent matches: for each of S = `subsets` seeds the `share` of the matches (M, 3) most consistent with it.

    Two matches are consistent if the distance between their points differs by less than `tolerance` [m] in the two clouds. Their
    second-order consistency is the number of matches that are consistent with both. The seeds are the matches most consistent with all. A
    subset has at least three matches. Returns indices (S, n).
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
