"""How sharp an image is, without a reference: the steepness of its fine structure against that of its coarse structure.

Motion blur takes the energy of fine gradients and leaves that of coarse ones. Both change alike with contrast and exposure.
"""

from collections import deque
from statistics import median

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.storage.state import State, Stateful

_ROWS = 240  # of the image whose gradients are the fine ones; more: narrower blur is seen, and noise counts more. Chosen by hand
_COARSE = 4  # times fewer rows has the image of the coarse ones; more: wider blur is told apart, and other scenes pass for it. By hand
_FLAT = 1e-5  # [1/px^2] energy of noise, added to that of the coarse gradients; more: images of bare walls count as blurred. Chosen by hand
_LEAST = 1e-3  # [1] sharpness that is added to both of a comparison; more: images without any structure count as alike. Chosen by hand
_MEAN = np.full((1, 3), np.float32(1 / 3))  # of the channels
_NEIGHBOURS = 9  # [frames] before one with which it is compared; more: long blur is seen, and a change of scene passes for blur. By hand


class Sharpness(Stateful):
    """The sharpness of each frame against those before it."""

    def __init__(self) -> None:
        self._before: deque[float] = deque(maxlen=_NEIGHBOURS)

    def state(self) -> State:
        """The sharpness of the last frames."""
        return {"before": list(self._before)}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._before = deque(state["before"], maxlen=_NEIGHBOURS)

    @property
    def latest(self) -> float | None:
        """The sharpness of the frame measured last [1]; None before the first."""
        return self._before[-1] if self._before else None

    def of_next(self, colour: NDArray[np.float32]) -> float:
        """The next frame's sharpness as a share of the median of the frames before it [1]; colour (H, W, 3) in [0, 1]."""
        of_image = sharpness(colour)
        share = (of_image + _LEAST) / (median(self._before) + _LEAST) if self._before else 1.0
        self._before.append(of_image)
        return share


def sharpness(colour: NDArray[np.float32]) -> float:
    """The energy of the fine gradients of an image (H, W, 3) over that of its coarse gradients [1]. For images of about one view."""
    grey = np.asarray(cv2.transform(colour, _MEAN), np.float32)
    fine = _shrunk(grey, max(1, colour.shape[0] // _ROWS))
    return _energy(fine) / (_energy(_shrunk(fine, _COARSE)) + _FLAT)


def _shrunk(image: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """The means of factor x factor pixels; an image of fewer pixels stays as it is."""
    height, width = image.shape[0] // factor, image.shape[1] // factor
    if min(height, width) < 3:
        return image
    small = cv2.resize(image[: height * factor, : width * factor], (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32)


def _energy(image: NDArray[np.float32]) -> float:
    """The mean squared gradient [1/px^2] of an image (H, W)."""
    height, width = image.shape
    along_rows = cv2.norm(image[:, 2:], image[:, :-2], cv2.NORM_L2SQR) / (height * (width - 2))
    along_columns = cv2.norm(image[2:], image[:-2], cv2.NORM_L2SQR) / ((height - 2) * width)
    return (along_rows + along_columns) / 4
