"""The loss by which features of pixels that see the same point learn to find each other."""

import torch
from torch import Tensor


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
