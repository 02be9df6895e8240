"""The contrastive loss: features of pixels that see the same point should be more similar than all others."""

import torch
from torch import Tensor


def contrastive_loss(queries: Tensor, features: Tensor, uv: Tensor, temperature: float) -> Tensor:
    """Cross-entropy of each query (N, C) being at its pixel uv (N, 2) among all pixels of unit features (C, H, W).

    The target is a Gaussian with 0.7 pixels standard deviation on the 3 x 3 pixels around uv, which is about the accuracy of registration.
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
