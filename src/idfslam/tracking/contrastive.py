"""Which pixels of two views see the same point, and the loss by which their features learn to find each other."""

from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.geometry import se3
from idfslam.tracking.footage import View


@dataclass(frozen=True)
class Partners:
    """Pixels of one view that another sees too."""

    index: Tensor  # (N,) int64, flat
    uv: Tensor  # (N, 2) their places in the other view [px]
    agreement: float  # the share of the points on measured pixels of the other view, not hidden behind them, that lie on its surface


@torch.no_grad()
def partners(T_ab: Tensor, a: View, b: View, tolerance: float = 0.03) -> Partners:
    """Pixels of b that a sees too, by pose and depth, which agree within `tolerance` times the depth, taken as 1 m at least."""
    index = b.valid.flatten().nonzero()[:, 0]
    uv, z = a.camera.project(se3.transform(T_ab.to(b.points), b.points.flatten(0, 1)[index]))
    inside = a.camera.inside(uv, z)
    index, uv, z = index[inside], uv[inside], z[inside]
    nearest = uv.round().long()
    behind = z - a.points[nearest[:, 1], nearest[:, 0], 2]
    measured, slack = a.valid[nearest[:, 1], nearest[:, 0]], tolerance * z.clamp(min=1)
    agrees = measured & (behind.abs() < slack)
    visible = measured & (behind < slack)
    return Partners(index[agrees], uv[agrees], float(agrees.sum() / visible.sum().clamp(min=1)))


def contrastive_loss(queries: Tensor, features: Tensor, uv: Tensor, temperature: float) -> Tensor:
    """Cross-entropy of finding each query (N, C) at its place (N, 2) among all pixels of unit features (C, H, W).

    The place is a Gaussian of 0.7 pixels over the 3 x 3 pixels around it: poses found by registration are no more exact than that.
    """
    height, width = features.shape[1:]
    offsets = torch.tensor([[x, y] for y in (-1, 0, 1) for x in (-1, 0, 1)], device=uv.device)
    pixels = uv.round().long()[:, None] + offsets
    inside = (pixels >= 0).all(-1) & (pixels[..., 0] < width) & (pixels[..., 1] < height)
    share = inside * torch.exp(-(pixels - uv[:, None]).square().sum(-1) / (2 * 0.7**2))
    logits = queries @ features.flatten(1) / temperature
    index = (pixels[..., 1] * width + pixels[..., 0]).where(inside, 0)
    log_likelihood = logits.gather(1, index) - logits.logsumexp(-1, keepdim=True)
    return -(share * log_likelihood).sum(-1).div(share.sum(-1)).mean()
