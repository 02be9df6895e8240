"""The noise of an image, from the image alone.

Second differences along both axes take out what is smooth. Edges leave large ones, and noise leaves some everywhere: so it follows from
their median (Immerkær, "Fast noise variance estimation", Computer Vision and Image Understanding 1996, who takes the mean).
"""

from torch import Tensor

_MEDIAN = 0.6745  # [1] median of the absolute value of normal numbers of deviation 1: a fact, not a choice
_GROWTH = 6.0  # [1] deviation of these differences over that of the noise: a fact, not a choice


def noise_of(image: Tensor) -> float:
    """The standard deviation of the noise of an image (h, w) of at least 3 x 3 pixels. Fine texture counts as noise."""
    return float(image.diff(n=2, dim=0).diff(n=2, dim=1).abs().median()) / (_MEDIAN * _GROWTH)
