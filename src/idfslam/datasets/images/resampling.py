"""Brings colour and depth images of different sizes, as phones record them, to one size without inventing readings.

Colour has far more pixels than depth, and every pixel costs time: it is downscaled. Depth is upscaled. Between neighbours on one surface
its inverse is interpolated, which is exact on a plane; repeating the nearest reading would turn every slanted wall into stairs, with the
normals of the steps. At an edge, or next to a pixel without a reading, the nearest reading is used as it is.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.images.decoding import Depth, readings

LARGEST = 640  # [px] longest side of the images that SLAM gets; raised, frames cost more time and depth has no more detail
ONE_SURFACE = 1.05  # [1] largest ratio of neighbouring depths on one surface; raised, more edges are smeared. Chosen by hand


def limited_size(width: int, height: int) -> tuple[int, int]:
    """Width and height [px] of an image scaled to at most 640 pixels a side; its proportions are kept."""
    factor = min(1.0, LARGEST / max(width, height))
    return round(width * factor), round(height * factor)


class OneView:
    """Brings colour and depth images of one view, each of its own size, to the size that phone recordings get too.

    Called with colour (H, W, 3) BGR and depth (h, w) as stored; returns both at `size` (width, height).
    """

    def __init__(self, colour: tuple[int, int], depth: tuple[int, int]) -> None:
        self.colour, self.depth = colour, depth  # width, height [px]
        self.size = max(limited_size(*colour), min(colour, depth))

    @staticmethod
    def fits(colour: tuple[int, int], depth: tuple[int, int]) -> bool:
        """Whether images of two sizes (width, height) have the same proportions, up to rounding to whole pixels."""
        (W, H), (w, h) = max(colour, depth), min(colour, depth)
        return abs(W * h - w * H) <= max(W, H) / 2

    def __str__(self) -> str:
        (W, H), (w, h) = self.colour, self.depth
        sizes = f"depth images of {w}x{h} are taken for the view of the colour images of {W}x{H}"
        return f"{sizes}; if a camera of its own took them, describe it in cam_params.json (depth_camera and T_colour_depth)"

    def __call__(self, bgr: NDArray[np.uint8], raw: Depth) -> tuple[NDArray[np.uint8], Depth]:
        depth = upscaled_depth(raw, self.size) if raw.shape[1] < self.size[0] else _picked(raw, self.size)
        return downscaled_colour(bgr, self.size), depth


def downscaled_colour(bgr: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """The image (H, W, 3) at a smaller size (width, height); each pixel is the mean of the area that it covers."""
    return bgr if size == (bgr.shape[1], bgr.shape[0]) else np.asarray(cv2.resize(bgr, size, interpolation=cv2.INTER_AREA), np.uint8)


def upscaled_depth(raw: Depth, size: tuple[int, int]) -> NDArray[np.float32]:
    """Depth (h, w) as stored at a larger size (width, height); 0 where the nearest pixel has no reading. The outer edges stay in place."""
    (height, width), has_reading = raw.shape, readings(raw)
    x, y = _sample_positions(width, size[0]), _sample_positions(height, size[1])
    nearest = np.where(has_reading, raw, 0).astype(np.float32)[np.ix_(np.rint(y).astype(int), np.rint(x).astype(int))]
    if min(height, width) < 2:
        return nearest
    inverse = np.divide(1, raw, out=np.zeros(raw.shape, np.float32), where=has_reading, dtype=np.float32)
    far, near = _over_quads(inverse, np.minimum), _over_quads(inverse, np.maximum)  # the smallest inverse is the farthest; 0: no reading
    quad = np.ix_(np.floor(y).astype(int).clip(0, height - 2), np.floor(x).astype(int).clip(0, width - 2))
    smooth = ((far > 0) & (near <= ONE_SURFACE * far))[quad]
    blended = np.asarray(cv2.resize(inverse, size, interpolation=cv2.INTER_LINEAR), np.float32)
    return np.divide(1, blended, out=nearest, where=smooth, dtype=np.float32)


def _picked(raw: Depth, size: tuple[int, int]) -> Depth:
    """Depth (h, w) at a size (width, height) that is not larger, of the nearest pixels."""
    x, y = _sample_positions(raw.shape[1], size[0]), _sample_positions(raw.shape[0], size[1])
    return np.ascontiguousarray(raw[np.ix_(np.rint(y).astype(int), np.rint(x).astype(int))])


def _sample_positions(count: int, new_count: int) -> NDArray[np.float64]:
    """(new_count,) coordinates, in a row of `count` pixels, of the centres of `new_count` pixels that cover the same length."""
    return ((np.arange(new_count) + 0.5) * count / new_count - 0.5).clip(0, count - 1)


def _over_quads(image: NDArray[np.float32], reduce: np.ufunc) -> NDArray[np.float32]:
    """(h - 1, w - 1) the minimum or maximum of each four neighbours."""
    rows = reduce(image[:-1], image[1:])
    return np.asarray(reduce(rows[:, :-1], rows[:, 1:]), np.float32)
