"""Frames, the input of SLAM, and the result for each of them."""

import zlib
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera

_CHECKED_ROWS = 8  # every eighth row of an image enters its checksum; raised, checksums are faster and miss more. Chosen by hand


@dataclass(frozen=True)
class Frame:
    """One RGB-D image without distortion; depth is registered to colour."""

    index: int
    timestamp: float  # [s]
    colour: NDArray[np.float32]  # (H, W, 3) RGB in [0, 1]
    depth: NDArray[np.float32]  # (H, W) z-depth [m], 0 = no reading
    camera: Camera

    @staticmethod
    def blank(index: int, timestamp: float, camera: Camera) -> "Frame":
        """A frame in place of one that could not be read: black, without depth. SLAM treats it as lost."""
        shape = (camera.height, camera.width)
        return Frame(index, timestamp, np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), camera)

    def checksum(self) -> int:
        """CRC-32 of some rows of its images; a resumed run checks with it that the recording has not changed."""
        colour, depth = (image[::_CHECKED_ROWS].tobytes() for image in (self.colour, self.depth))
        return zlib.crc32(depth, zlib.crc32(colour))


class Status(str, Enum):
    """How a frame's pose was found."""

    OK = "ok"
    DEGENERATE = "degenerate"  # depth does not constrain all directions (a bare wall); tracker and colour decided the rest
    LOST = "lost"  # no pose was confirmed: the last motion was extrapolated
    INTERPOLATED = "interpolated"  # was lost; after relocalisation the pose was interpolated between the confirmed ones before and after

    @property
    def measured(self) -> bool:
        """Whether the frame's images gave its pose. Other poses are made up; before the first depth they are those of the first camera."""
        return self in (Status.OK, Status.DEGENERATE)


@dataclass(frozen=True)
class FrameResult:
    """The result of `Slam.process` for one frame."""

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
