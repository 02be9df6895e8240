"""Repeated images: a camera that stalls, or a recorder that fills in, gives the colour or the depth image of the frame before once more.

Such an image shows an earlier moment. It would hold the pose where the camera was then, and the other image would seem to confirm it.
A sensor's noise never repeats, so images that are equal to the bit are one image. A frame of which both are repeated is the frame before
once more, or one of a camera that stands still and has no noise. In both cases it has that frame's pose, and what counts of that frame
counts of it.
"""

import logging
import zlib
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from idfslam.frame import Frame
from idfslam.storage.state import State, Stateful

log = logging.getLogger(__name__)

_CHECKED_ROWS = 8  # every eighth row of an image enters its checksum; raised, frames are checked faster, and less of them. Chosen by hand


class RepeatedImages(Stateful):
    """Compares the images of each frame with those of the frame before."""

    def __init__(self) -> None:
        self._checksums: tuple[int, int] | None = None  # of colour and depth of the last frame; None: no frame yet
        self._depth_is_older = False  # whether the last frame's depth was left out
        self._told = False  # whether a repeated image was logged
        self.colour_since = 0
        """The number of the frame at whose moment the last frame's colour image was new: its own, unless that is older than depth."""

    def state(self) -> State:
        """The checksums, and since when colour and depth have been the same."""
        checksums = None if self._checksums is None else list(self._checksums)
        older = self._depth_is_older
        return {"checksums": checksums, "told": self._told, "colour_since": self.colour_since, "depth_is_older": older}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._checksums = None if state["checksums"] is None else (state["checksums"][0], state["checksums"][1])
        self._told, self.colour_since, self._depth_is_older = state["told"], state["colour_since"], state["depth_is_older"]

    def check(self, frame: Frame) -> Frame:
        """The next frame; without depth if that is an older image than colour."""
        last, self._checksums = self._checksums, (_checksum(frame.colour), _checksum(frame.depth))
        same_colour, same_depth = (False, False) if last is None else (last[0] == self._checksums[0], last[1] == self._checksums[1])
        has_depth = bool(frame.depth[::_CHECKED_ROWS].any())
        again = same_colour and same_depth
        if not same_colour or (again and self.colour_since == frame.index - 1):
            self.colour_since = frame.index
        self._depth_is_older = same_depth and has_depth and (not same_colour or self._depth_is_older)
        if has_depth and same_colour != same_depth and not self._told:
            self._told = True
            repeated, other = ("colour", "depth") if same_colour else ("depth", "colour")
            log.warning("frame %d repeats the %s image of the frame before: %s alone tells of its pose", frame.index, repeated, other)
        return replace(frame, depth=np.zeros_like(frame.depth)) if self._depth_is_older else frame


def _checksum(image: NDArray[np.float32]) -> int:
    checksum, image = 0, np.ascontiguousarray(image)
    for row in range(0, len(image), _CHECKED_ROWS):  # a copy of them all takes longer than the checksum
        checksum = zlib.crc32(image[row].data, checksum)
    return checksum
