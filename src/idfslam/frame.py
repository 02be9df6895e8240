"""Frames, the input of SLAM, and the result for each of them."""

import math
import operator
import zlib
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from idfslam.errors import FrameError
from idfslam.frame_images import checked_colour, checked_depth, colour_from, depth_from
from idfslam.geometry.camera import Camera
from idfslam.geometry.sensor_timing import SYNCHRONISED, SensorTiming

FPS = 30.0  # [Hz] assumed where there are no time stamps

_ONE_SHOT = 0.1  # [s] largest difference of the stamps of colour and depth that is one. More: stamps of different clocks pass for a lag
_CHECKED_ROWS = 8  # every eighth row of an image enters its checksum; raised, checksums are faster and miss more. Chosen by hand


@dataclass(frozen=True)
class Frame:
    """One RGB-D image without distortion; depth is registered to colour.

    Its time stamps are those of the middle rows. Without a stamp of its own, depth is of the moment of colour.
    The arrays are as SLAM takes them; `Frame.from_images` converts those of cameras. Depth that is NaN, infinite or negative becomes 0.
    Raises FrameError if a value is none of a frame: another type, shape, size or range.
    """

    index: int  # frames of a run are numbered 0, 1, 2 ...
    timestamp: float  # [s]
    colour: NDArray[np.float32]  # (H, W, 3) RGB in [0, 1]
    depth: NDArray[np.float32]  # (H, W) z-depth [m], 0 = no reading
    camera: Camera
    depth_timestamp: float | None = None  # [s] None: `timestamp`
    timing: SensorTiming = SYNCHRONISED  # read-out times of the two images, and delay of depth

    def __post_init__(self) -> None:
        _check_camera(self.camera)
        if not isinstance(self.timing, SensorTiming):
            raise FrameError(f"timing is {type(self.timing).__name__}, expected a SensorTiming(readout, depth_readout, depth_delay)")
        timestamp = _checked_timestamp(self.timestamp)
        checked = {
            "index": _checked_index(self.index),
            "timestamp": timestamp,
            "depth_timestamp": timestamp if self.depth_timestamp is None else _checked_timestamp(self.depth_timestamp),
            "colour": checked_colour(self.colour, self.camera),
            "depth": checked_depth(self.depth, self.camera),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)  # the way to set what is frozen

    @staticmethod
    def from_images(
        colour: ArrayLike,
        depth: ArrayLike,
        camera: Camera,
        *,
        index: int = 0,
        timestamp: float | None = None,
        depth_scale: float | None = None,
        bgr: bool = False,
        depth_timestamp: float | None = None,
        timing: SensorTiming = SYNCHRONISED,
    ) -> "Frame":
        """A frame from images as cameras give them: numpy arrays, or what `numpy.asarray` takes (PIL images), or tensors.

        colour: (H, W, 3) RGB, (H, W, 4) with alpha, which is dropped, or (H, W) grey; uint8, uint16, or floats from 0 to 1.
        depth: (H, W), registered to colour and of its size; integers or floats. No reading: 0, negative, NaN, infinity, 65535.
        index: 0 for the first frame of a run, 1 for the next, and so on. timestamp: [s]; None: `index` / 30.
        depth_scale: units of depth per metre; None: 1000 for integers (millimetres), 1 for floats (metres).
        bgr: colour is BGR or BGRA, as OpenCV has it.
        depth_timestamp: [s] of depth; None: `timestamp`. timing: the read-out times of the two cameras.
        Raises FrameError if the images are none of these.
        """
        _check_camera(camera)
        number = _checked_index(index)
        stamp = number / FPS if timestamp is None else timestamp
        images = colour_from(colour, camera, bgr=bgr), depth_from(depth, camera, depth_scale=depth_scale)
        return Frame(number, stamp, *images, camera, depth_timestamp, timing)

    @property
    def depth_lag(self) -> float:
        """[s] by which depth's time stamp is later than colour's; 0 where they are so far apart that their clocks differ."""
        lag = 0.0 if self.depth_timestamp is None else self.depth_timestamp - self.timestamp
        return lag if abs(lag) <= _ONE_SHOT else 0.0

    @property
    def synchronised(self) -> bool:
        """Whether all its rows, of both images, are stated to be of one moment."""
        return self.timing == SYNCHRONISED and self.depth_lag == 0

    @staticmethod
    def blank(index: int, timestamp: float, camera: Camera) -> "Frame":
        """A frame in place of one that could not be read: black, without depth. SLAM loses it, as nothing in it confirms a pose."""
        shape = (camera.height, camera.width)
        return Frame(index, timestamp, np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), camera)

    def checksum(self) -> int:
        """CRC-32 of some rows of its images; a resumed run checks with it that the recording has not changed."""
        colour, depth = (image[::_CHECKED_ROWS].tobytes() for image in (self.colour, self.depth))
        return zlib.crc32(depth, zlib.crc32(colour))


def _check_camera(camera: object) -> None:
    if not isinstance(camera, Camera):
        raise FrameError(f"camera is {type(camera).__name__}, expected a Camera(width, height, fx, fy, cx, cy)")


def _checked_index(index: int) -> int:
    try:
        number = operator.index(index)
    except TypeError:
        number = -1
    if number < 0:
        raise FrameError(f"index is {index!r}, expected 0 for the first frame, 1 for the next, and so on")
    return number


def _checked_timestamp(timestamp: float) -> float:
    try:
        stamp = float(timestamp)
    except (TypeError, ValueError, OverflowError):
        stamp = math.nan
    if not math.isfinite(stamp):
        raise FrameError(f"timestamp is {timestamp!r}, expected seconds as a finite number")
    return stamp


class Status(str, Enum):
    """How a frame's pose was found."""

    OK = "ok"
    DEGENERATE = "degenerate"  # depth does not constrain all directions (a bare wall, no depth); images, tracker or the last motion did
    DOUBTFUL = "doubtful"  # the images gave a pose, but the evidence for it is weak: the frame is not mapped
    LOST = "lost"  # no pose was confirmed: the last motion was extrapolated
    INTERPOLATED = "interpolated"  # was lost; after relocalisation the pose was interpolated between the confirmed ones before and after

    @property
    def measured(self) -> bool:
        """Whether the frame's images gave its pose. Other poses are made up; before the first depth they are those of the first camera."""
        return self in (Status.OK, Status.DEGENERATE, Status.DOUBTFUL)

    @property
    def trusted(self) -> bool:
        """Whether the pose is measured and not in doubt. Only frames with such a pose are mapped, fused or exported as posed images."""
        return self.measured and self is not Status.DOUBTFUL


@dataclass(frozen=True)
class FrameResult:
    """The result of `Slam.process` for one frame."""

    index: int
    timestamp: float  # [s]
    T_wc: NDArray[np.float64]  # (4, 4)
    status: Status
    keyframe: bool
    losses: dict[str, float]
    covariance: NDArray[np.float64] | None = None  # (6, 6) of the pose's error in the map, see `Tracked.covariance`; None: not estimated
    moving: NDArray[np.bool_] | None = None  # (H, W) pixels that show what moves; None: none

    @property
    def moving_share(self) -> float:
        """[1] share of the pixels that show what moves."""
        return 0.0 if self.moving is None else np.count_nonzero(self.moving) / self.moving.size

    @property
    def sigma_position(self) -> float | None:
        """[m] by which the position is expected to be off (root mean square): the root of the trace of its covariance."""
        return None if self.covariance is None else float(np.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def sigma_rotation(self) -> float | None:
        """[degrees] by which the rotation is expected to be off (root mean square): the root of the trace of its covariance."""
        return None if self.covariance is None else math.degrees(np.sqrt(np.trace(self.covariance[3:, 3:])))


@dataclass(frozen=True, eq=False)
class StoredKeyframe:
    """A keyframe as the viewer and the result folder see it; `Slam.stored_keyframes` numbers them from 0."""

    index: int  # its frame
    T_wk: NDArray[np.float64]  # (4, 4)
    covisible: frozenset[int]  # numbers of the stored keyframes that see the same surface
    submap: int  # 0: the largest, whose poses are reported; others have not been merged with it yet
    camera: Camera
    covariance: NDArray[np.float64] | None = None  # (6, 6) of xi, where T_wk exp(xi) is the true pose [m, rad]; None: not known
