"""The pixels that a camera fills. Undistorted images have black borders, which are no part of the scene; so have some recordings.

They are found in the images themselves: black in all of them, and connected with the border.
"""

from collections.abc import Iterable, Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

# All of these were chosen by hand.
_BLACK = 24  # of 255: a pixel that is never brighter is black, ripples of JPEG beside bright pixels included. More: dark corners go
_MARGIN = 3  # [px] beside black pixels that are mixed with them. More: less of the image is used
_MOST = 0.25  # [1] share of black pixels above which it is the scene that is dark. More: dark recordings lose pixels


class LitArea:
    """Watches images of one size go by."""

    def __init__(self, height: int, width: int) -> None:
        self._brightest = np.zeros((height, width), np.uint8)

    def watched(self, images: Iterable[NDArray[np.uint8]]) -> Iterator[NDArray[np.uint8]]:
        """The same images (H, W, 3), one after the other."""
        for image in images:
            for channel in range(image.shape[-1]):  # ten times as fast as image.max(-1)
                np.maximum(self._brightest, image[..., channel], out=self._brightest)
            yield image

    def pixels(self) -> NDArray[np.bool_]:
        """Whether the images so far fill each pixel (H, W)."""
        black = (self._brightest <= _BLACK).astype(np.uint8)
        labels = cv2.connectedComponents(np.pad(black, 1, constant_values=1))[1]
        outside = (labels == labels[0, 0])[1:-1, 1:-1]
        if not outside.any() or outside.mean() > _MOST:
            return np.ones(black.shape, bool)
        size = 2 * _MARGIN + 1
        return np.asarray(cv2.dilate(outside.astype(np.uint8), np.ones((size, size), np.uint8)) == 0)
