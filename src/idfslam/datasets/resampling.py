"""Colour and depth of one view in different sizes, as phones record them, brought to one size without inventing a reading.

Colour has far more pixels than depth can use, and costs time with each of them: it is reduced. Depth has few: between neighbours on one
surface its inverse is interpolated, which is exact on a plane (the nearest readings would turn every slanted wall into stairs, with
the steps' normals); at an edge, or beside a pixel without a reading, the nearest reading stands alone.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.images import Depth, readings

LARGEST = 640  # [px] the longer side of the images that the system is handed
ONE_SURFACE = 1.05  # depths of neighbours that differ by no more than this ratio lie on one surface


def moderate(width: int, height: int) -> tuple[int, int]:
    """Width and height [px] of an image reduced to at most 640 pixels a side, in its proportions."""
    factor = min(1.0, LARGEST / max(width, height))
    return round(width * factor), round(height * factor)


def reduced(bgr: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """The image at another size (width, height), by the mean of the pixels that fall together."""
    return bgr if size == (bgr.shape[1], bgr.shape[0]) else np.asarray(cv2.resize(bgr, size, interpolation=cv2.INTER_AREA), np.uint8)


def enlarged(raw: Depth, size: tuple[int, int]) -> NDArray[np.float32]:
    """Depth (h, w) as stored at another size (width, height); 0 where the nearest pixel has no reading. The outer edges stay in place."""
    (height, width), known = raw.shape, readings(raw)
    x, y = _places(width, size[0]), _places(height, size[1])
    nearest = np.where(known, raw, 0).astype(np.float32)[np.ix_(np.rint(y).astype(int), np.rint(x).astype(int))]
    if min(height, width) < 2:
        return nearest
    inverse = np.divide(1, raw, out=np.zeros(raw.shape, np.float32), where=known, dtype=np.float32)
    far, near = _over_quads(inverse, np.minimum), _over_quads(inverse, np.maximum)  # the least inverse is the farthest; 0: no reading
    quad = np.ix_(np.floor(y).astype(int).clip(0, height - 2), np.floor(x).astype(int).clip(0, width - 2))
    smooth = ((far > 0) & (near <= ONE_SURFACE * far))[quad]
    blended = np.asarray(cv2.resize(inverse, size, interpolation=cv2.INTER_LINEAR), np.float32)
    return np.divide(1, blended, out=nearest, where=smooth, dtype=np.float32)


def _places(count: int, wanted: int) -> NDArray[np.float64]:
    """(wanted,) coordinates in a row of `count` pixels of the centres of `wanted` pixels over the same length."""
    return ((np.arange(wanted) + 0.5) * count / wanted - 0.5).clip(0, count - 1)


def _over_quads(image: NDArray[np.float32], reduce: np.ufunc) -> NDArray[np.float32]:
    """(h - 1, w - 1): the least or greatest of each four neighbours."""
    rows = reduce(image[:-1], image[1:])
    return np.asarray(reduce(rows[:, :-1], rows[:, 1:]), np.float32)
