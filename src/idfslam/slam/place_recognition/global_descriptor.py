"""The global descriptor: a unit vector for the tracker's features of a whole image, similar for images of the same place.

VLAD (Jegou et al., "Aggregating local descriptors into a compact image representation", CVPR 2010): each feature is assigned to the words
of a codebook, and for each word the descriptor has the sum of the differences of its features from it, normalised. The codebook comes from
the recording's own first image.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

# All four were chosen by hand. With them an overlapping keyframe is among the first five in 82 to 84 % of cases (redkitchen, kitchen).
_WORDS = 32  # words of the codebook. More: places are distinguished better, by longer descriptors (32 C numbers)
_ROUNDS = 10  # iterations of k-means. More: nothing, it has converged
_STRIDE = 7  # [px] stride of the pixels in k-means. More: faster, and a coarser codebook
_SHARPNESS = 20.0  # [1] sharpness of the soft assignment of features to words. More: nearer to hard assignment


def codebook(features: Tensor, *, words: int = _WORDS) -> Tensor:
    """Visual words (words, C), unit vectors, by k-means of the unit features (C, h, w) of an image. The result is deterministic."""
    samples = features.flatten(1).mT[::_STRIDE]
    centres = samples[torch.linspace(0, len(samples) - 1, words, device=samples.device).long()]
    for _ in range(_ROUNDS):
        nearest = F.one_hot((samples @ centres.mT).argmax(1), words).to(samples)
        sums = nearest.mT @ samples
        centres = torch.where(sums.norm(dim=1, keepdim=True) > 0, F.normalize(sums, dim=1), centres)
    return centres


def global_descriptor(features: Tensor, words: Tensor) -> Tensor:
    """The descriptor (words * C,), a unit vector, of an image's unit features (C, h, w). The similarity of two is their scalar product."""
    pixels = features.flatten(1).mT
    share = F.softmax(_SHARPNESS * (pixels @ words.mT), 1)
    residuals = share.mT @ pixels - share.sum(0)[:, None] * words
    return F.normalize(F.normalize(residuals, dim=1).flatten(), dim=0)
