"""What a recording yields and what the system keeps of it."""

import zlib
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera

_CHECKED_ROWS = 8  # every so many-th row of an image counts in its checksum


@dataclass(frozen=True)
class Frame:
    """One RGB-D image, undistorted, depth registered to colour."""

    index: int
    timestamp: float  # [s]
    colour: NDArray[np.float32]  # (H, W, 3) RGB in [0, 1]
    depth: NDArray[np.float32]  # (H, W) z-depth [m], 0 = no reading
    camera: Camera

    @staticmethod
    def blank(index: int, timestamp: float, camera: Camera) -> "Frame":
        """A frame that could not be read: black, without depth; the system treats it as lost."""
        shape = (camera.height, camera.width)
        return Frame(index, timestamp, np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), camera)

    def checksum(self) -> int:
        """Of some rows of its images, to tell whether a recording still holds the same."""
        colour, depth = (image[::_CHECKED_ROWS].tobytes() for image in (self.colour, self.depth))
        return zlib.crc32(depth, zlib.crc32(colour))


class Status(str, Enum):
    """How a frame's pose was found."""

    OK = "ok"
    DEGENERATE = "degenerate"  # the geometry leaves a direction free (a bare wall): tracker and colour decided
    LOST = "lost"  # no evidence for any pose: the last motion was carried on
    INTERPOLATED = "interpolated"  # was lost; the camera was found again later, and the pose lies between those known


@dataclass(frozen=True)
class FrameResult:
    """What `Slam.process` says of a frame."""

    index: int
    timestamp: float  # [s]
    T_wc: NDArray[np.float64]  # (4, 4)
    status: Status
    keyframe: bool
    losses: dict[str, float]


@dataclass(frozen=True, eq=False)
class StoredKeyframe:
    """A keyframe as the viewer and the result folder see it; `Slam.stored_keyframes` numbers them from 0."""

    index: int  # its frame
    T_wk: NDArray[np.float64]  # (4, 4)
    covisible: frozenset[int]  # numbers of the stored keyframes that see the same surface
    submap: int  # 0: the first, whose poses are in the world; others have not been merged with it yet
    camera: Camera
