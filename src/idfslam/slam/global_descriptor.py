"""The place descriptor: the tracker's features of a whole image in one unit vector, near to those of images of the same place.

Features are told apart by visual words, and what is kept of each word is how its features differ from it in the mean: VLAD (Jegou et al.,
"Aggregating local descriptors into a compact image representation", CVPR 2010). The words come from the recording's own first image.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

_WORDS = 32
_ROUNDS = 10  # of k-means
_THIN = 7  # every so many-th pixel takes part in it
_SHARPNESS = 20.0  # of the soft assignment of a feature to its words


def vocabulary(features: Tensor, *, words: int = _WORDS) -> Tensor:
    """Visual words (words, C): unit vectors, k-means of the unit features (C, h, w) of an image. The same image gives the same words."""
    samples = features.flatten(1).mT[::_THIN]
    centres = samples[torch.linspace(0, len(samples) - 1, words, device=samples.device).long()]
    for _ in range(_ROUNDS):
        nearest = F.one_hot((samples @ centres.mT).argmax(1), words).to(samples)
        sums = nearest.mT @ samples
        centres = torch.where(sums.norm(dim=1, keepdim=True) > 0, F.normalize(sums, dim=1), centres)
    return centres


def place_descriptor(features: Tensor, words: Tensor) -> Tensor:
    """(words * C,) unit vector of an image's unit features (C, h, w); the scalar product of two tells how alike their places look."""
    pixels = features.flatten(1).mT
    share = F.softmax(_SHARPNESS * (pixels @ words.mT), 1)
    residuals = share.mT @ pixels - share.sum(0)[:, None] * words
    return F.normalize(F.normalize(residuals, dim=1).flatten(), dim=0)
