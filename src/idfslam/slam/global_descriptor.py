"""The global descriptor: the tracker's features of a whole image as one unit vector, similar for images of the same place.

VLAD (Jegou et al., "Aggregating local descriptors into a compact image representation", CVPR 2010): each feature is assigned to the words
of a codebook, and the descriptor holds, for each word, the mean difference of its features from it. The codebook comes from the
recording's own first image.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

# With these an overlapping keyframe is among the first five in 82 to 84 % of cases (redkitchen, kitchen); the four were chosen by hand.
_WORDS = 32  # of the codebook; more: places are told apart better, by longer descriptors (32 C numbers)
_ROUNDS = 10  # of k-means; more: nothing, it has converged
_STRIDE = 7  # pixels of the image, of which one takes part in k-means; more: faster, and a coarser codebook
_SHARPNESS = 20.0  # of the soft assignment of a feature to its words [1]; more: nearer to hard assignment


def codebook(features: Tensor, *, words: int = _WORDS) -> Tensor:
    """Visual words (words, C), unit vectors: k-means of the unit features (C, h, w) of an image. It is deterministic."""
    samples = features.flatten(1).mT[::_STRIDE]
    centres = samples[torch.linspace(0, len(samples) - 1, words, device=samples.device).long()]
    for _ in range(_ROUNDS):
        nearest = F.one_hot((samples @ centres.mT).argmax(1), words).to(samples)
        sums = nearest.mT @ samples
        centres = torch.where(sums.norm(dim=1, keepdim=True) > 0, F.normalize(sums, dim=1), centres)
    return centres


def global_descriptor(features: Tensor, words: Tensor) -> Tensor:
    """(words * C,) unit vector of an image's unit features (C, h, w); the scalar product of two is the similarity of their places."""
    pixels = features.flatten(1).mT
    share = F.softmax(_SHARPNESS * (pixels @ words.mT), 1)
    residuals = share.mT @ pixels - share.sum(0)[:, None] * words
    return F.normalize(F.normalize(residuals, dim=1).flatten(), dim=0)
