"""The archive: images of keyframes that have not been used for long, packed without loss, in a temporary file.

However long a recording, the images of so many keyframes are in memory and no more; the file goes with the process.
"""

import tempfile
import zlib
from collections import OrderedDict
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera

_EIGHT_BITS = np.float32(1 / 255)  # colour of most cameras comes in such steps


class Archived(Protocol):
    """What has images that can be put away and had again."""

    def put_away(self) -> Frame: ...


@dataclass(frozen=True)
class Packed:
    """A frame in the archive's file."""

    index: int
    timestamp: float
    camera: Camera
    eight_bits: bool  # colour as PNG; otherwise as floats
    offset: int
    colour_bytes: int
    depth_bytes: int


class Archive:
    """Keeps the images of the `in_memory` most recently used owners where they are, and those of the others in a file."""

    def __init__(self, in_memory: int) -> None:
        self.in_memory = in_memory
        self._loaded: OrderedDict[int, Archived] = OrderedDict()  # the least recently used first
        self._packed: dict[int, Packed] = {}
        self._file = tempfile.TemporaryFile(prefix="idf-slam-")  # noqa: SIM115 (open as long as the archive)
        self._end = 0

    def used(self, key: int, owner: Archived) -> None:
        """The owner's images are in memory and were just used; those that have not been for longest are put away."""
        self._loaded[key] = owner
        self._loaded.move_to_end(key)
        while len(self._loaded) > self.in_memory:
            oldest, other = self._loaded.popitem(last=False)
            frame = other.put_away()
            if oldest not in self._packed:  # images never change: once is enough
                self._packed[oldest] = self._write(frame)

    def load(self, key: int) -> Frame:
        """The images that were put away, exactly as they were."""
        packed = self._packed[key]
        self._file.seek(packed.offset)
        colour = self._file.read(packed.colour_bytes)
        depth = np.frombuffer(zlib.decompress(self._file.read(packed.depth_bytes)), np.uint8)
        shape = (packed.camera.height, packed.camera.width)
        return Frame(packed.index, packed.timestamp, _colour(colour, shape, packed.eight_bits), _floats(depth, shape), packed.camera)

    def _write(self, frame: Frame) -> Packed:
        steps = np.rint(frame.colour * 255).astype(np.uint8)
        exact = bool(np.array_equal(steps * _EIGHT_BITS, frame.colour))
        colour = cv2.imencode(".png", steps, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes() if exact else _bytes(frame.colour)
        depth = _bytes(frame.depth)
        packed = Packed(frame.index, frame.timestamp, frame.camera, exact, self._end, len(colour), len(depth))
        self._file.seek(self._end)
        self._end += self._file.write(colour) + self._file.write(depth)
        return packed


def _bytes(values: NDArray[np.float32]) -> bytes:
    """Floats with their first bytes together, then their second, ...: these are alike from pixel to pixel."""
    return zlib.compress(np.ascontiguousarray(values, np.float32).view(np.uint8).reshape(-1, 4).T.tobytes(), 1)


def _floats(raw: NDArray[np.uint8], shape: tuple[int, ...]) -> NDArray[np.float32]:
    return np.ascontiguousarray(raw.reshape(4, -1).T).view(np.float32).reshape(shape)


def _colour(data: bytes, shape: tuple[int, int], eight_bits: bool) -> NDArray[np.float32]:
    if eight_bits:
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) * _EIGHT_BITS
    return _floats(np.frombuffer(zlib.decompress(data), np.uint8), (*shape, 3))
