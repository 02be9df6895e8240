"""RVL, the lossless coding of depth images (Wilson, ISS 2017) that compressed_depth_image_transport offers beside PNG.

A stream of numbers of 3 bits a nibble, the lowest first, the nibble's highest bit set where the number goes on. Numbers are: pixels without
a reading, pixels with one, and for each of these its difference from the reading before it; and so on.
"""

import struct

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.images.array_files import MOST_VALUES
from idfslam.errors import FrameError

_SIZE = struct.Struct("<II")  # width, height [px]
_LONGEST = 11  # [nibbles] of a number of 32 bits: a fact of the coding


def decode_rvl(data: bytes, source: str) -> NDArray[np.uint16]:
    """The depth image (H, W) of a message's data after its header; raises FrameError if it is damaged."""
    if len(data) < _SIZE.size:
        raise FrameError(f"{source}: {len(data)} bytes, expected a depth image coded by RVL: copy the recording again")
    width, height = _SIZE.unpack_from(data)
    if not 0 < width * height <= MOST_VALUES:
        raise FrameError(f"{source}: {width}x{height}, expected the size of a depth image: copy the recording again")
    numbers = _numbers(np.frombuffer(data, "<u4", (len(data) - _SIZE.size) // 4, _SIZE.size), source)
    image = np.zeros(width * height, np.uint16)
    at, pixel, readings, differences = 0, 0, [], []
    while pixel < len(image):
        empty, full = numbers[at : at + 2].tolist() if at + 2 <= len(numbers) else (len(image), 1)
        pixel, at = pixel + empty, at + 2
        if pixel + full > len(image) or at + full > len(numbers):
            raise FrameError(f"{source}: RVL data end or overrun the image of {width}x{height}: copy the recording again")
        readings.append(np.arange(pixel, pixel + full))
        differences.append(numbers[at : at + full])
        pixel, at = pixel + full, at + full
    zigzag = np.concatenate(differences)
    image[np.concatenate(readings)] = np.cumsum((zigzag >> 1) ^ -(zigzag & 1)).astype(np.uint16)
    return image.reshape(height, width)


def _numbers(words: NDArray[np.uint32], source: str) -> NDArray[np.int64]:
    """The numbers of a stream of words of 8 nibbles, the highest first."""
    nibbles = (words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32) & 15).ravel().astype(np.int64)
    ends = np.flatnonzero(nibbles < 8)
    if not len(ends):
        return np.zeros(0, np.int64)
    starts = np.concatenate([[0], ends[:-1] + 1])
    if (ends - starts).max() >= _LONGEST:
        raise FrameError(f"{source}: RVL data are damaged: copy the recording again")
    nibbles = nibbles[: ends[-1] + 1]
    place = np.arange(len(nibbles)) - np.repeat(starts, ends - starts + 1)
    numbers: NDArray[np.int64] = np.add.reduceat((nibbles & 7) << (3 * place), starts)
    return numbers
