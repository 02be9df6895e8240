"""The archive: images of keyframes that have not been used for long, in a temporary file.

However long a recording, the images of so many keyframes are in memory and no more; the file goes with the process. Nothing is packed:
replay asks for some of them at each update of the map, and the system's cache gives them faster than anything unpacks.
"""

import tempfile
from collections import OrderedDict
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera

_EIGHT_BITS = np.float32(1 / 255)  # colour of most cameras comes in such steps


class Archived(Protocol):
    """What has images that can be put away and had again."""

    def put_away(self) -> Frame: ...


@dataclass(frozen=True)
class Stored:
    """A frame in the archive's file."""

    index: int
    timestamp: float
    camera: Camera
    offset: int  # where its colour begins; its depth follows
    colour: DTypeLike  # of whole steps of 1 / 255, or floats


class Archive:
    """Keeps the images of the `in_memory` most recently used owners where they are, and those of the others in a file."""

    def __init__(self, in_memory: int) -> None:
        self.in_memory = in_memory
        self._loaded: OrderedDict[int, Archived] = OrderedDict()  # the least recently used first
        self._stored: dict[int, Stored] = {}
        self._file = tempfile.TemporaryFile(prefix="idf-slam-")  # noqa: SIM115 (open as long as the archive)
        self._end = 0

    def used(self, key: int, owner: Archived) -> None:
        """The owner's images are in memory and were just used; those that have not been for longest are put away."""
        self._loaded[key] = owner
        self._loaded.move_to_end(key)
        while len(self._loaded) > self.in_memory:
            oldest, other = self._loaded.popitem(last=False)
            frame = other.put_away()
            if oldest not in self._stored:  # images never change: once is enough
                self._stored[oldest] = self._write(frame)

    def load(self, key: int) -> Frame:
        """The images that were put away, exactly as they were."""
        stored = self._stored[key]
        shape = stored.camera.height, stored.camera.width
        self._file.seek(stored.offset)
        colour, depth = self._read((*shape, 3), stored.colour), self._read(shape, np.float32)
        if colour.dtype == np.uint8:
            colour = np.multiply(colour, _EIGHT_BITS, dtype=np.float32)
        return Frame(stored.index, stored.timestamp, colour, depth, stored.camera)

    def _write(self, frame: Frame) -> Stored:
        steps = np.rint(frame.colour * 255).astype(np.uint8)
        exact = np.array_equal(steps * _EIGHT_BITS, frame.colour)
        colour: NDArray[np.uint8] | NDArray[np.float32] = steps if exact else frame.colour
        stored = Stored(frame.index, frame.timestamp, frame.camera, self._end, colour.dtype)
        self._file.seek(self._end)
        for image in (colour, frame.depth):
            self._end += self._file.write(np.ascontiguousarray(image).data)
        return stored

    def _read(self, shape: tuple[int, ...], kind: DTypeLike) -> NDArray[np.float32]:
        image = np.empty(shape, kind)
        self._file.readinto(image.data)
        return image
