"""Clipped images: what is too dark or too bright for a camera is black or white, and shows nothing.

In darkness, before the sun, and while automatic exposure follows, an image has next to no other pixels. It neither confirms a pose nor
contradicts one.
"""

import numpy as np
from numpy.typing import NDArray

# All of these were chosen by hand.
# [1] Brightness below which a pixel is black (8 steps of 255), and above which it is white. A wider range between: darker and brighter
# images still count as showing something, which is noise, or edges of what is clipped
_BLACK, _WHITE = 0.03, 0.98
# [1] Share of the pixels between these, below which the image is clipped. More: images that show something in a small part are, too
_LEAST_SHOWN = 0.1
_STRIDE = 8  # [pixels] every so many rows and columns are looked at. More: faster


def is_clipped(colour: NDArray[np.float32]) -> bool:
    """Whether next to nothing of an image (H, W, 3) in [0, 1] is neither black nor white."""
    brightness = colour[::_STRIDE, ::_STRIDE].mean(-1)
    return float(((brightness > _BLACK) & (brightness < _WHITE)).mean()) < _LEAST_SHOWN
