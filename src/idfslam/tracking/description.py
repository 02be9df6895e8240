"""A frame as the tracker keeps it: images at the tracker's resolution, points, and the trunk's features."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera


@dataclass(frozen=True)
class Described:
    """A frame at the tracker's resolution (h, w).

    It holds the trunk's output rather than features, so that a finetuned out-conv holds for stored keyframes as well.
    """

    trunk: Tensor  # (64, h, w)
    colour: Tensor  # (3, h, w) in [0, 1]
    points: Tensor  # (h, w, 3) in the camera's frame [m]; z = 0: no depth
    camera: Camera  # of the (h, w) image
    source: Camera  # of the recording's image

    @property
    def valid(self) -> Tensor:
        """(h, w) bool: pixels with depth."""
        return self.points[..., 2] > 0


def reduced(frame: Frame, height: int) -> tuple[NDArray[np.float32], NDArray[np.float32], Camera]:
    """Colour (h, w, 3), depth (h, w) [m] and camera of the frame reduced to `height` rows (never enlarged)."""
    h = min(height, frame.camera.height)
    w = round(frame.camera.width * h / frame.camera.height)
    colour = cv2.resize(frame.colour, (w, h), interpolation=cv2.INTER_AREA)
    return colour.astype(np.float32, copy=False), subsampled_depth(frame.depth, h, w), frame.camera.resized(w, h)


def subsampled_depth(depth: NDArray[np.float32], height: int, width: int) -> NDArray[np.float32]:
    """Depth (H, W) at the centres of a (height, width) image; a missing reading is taken from a pixel beside it, never averaged."""
    rows = ((np.arange(height) + 0.5) * depth.shape[0] / height).astype(int)
    columns = ((np.arange(width) + 0.5) * depth.shape[1] / width).astype(int)
    out = depth[np.ix_(rows, columns)]
    for up, left in ((1, 0), (0, 1), (1, 1)):
        beside = depth[np.ix_(np.maximum(rows - up, 0), np.maximum(columns - left, 0))]
        out = np.where(out > 0, out, beside)
    return out
