"""The interface of all datasets; a recording whose images are read on request; a selection of its frames."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration, DepthCameraCalibration
from idfslam.datasets.cameras.camera_files import CAM_PARAMS
from idfslam.datasets.images.decoding import Depth, Undistortion, has_readings, metres, readings, rgb
from idfslam.datasets.images.depth_registration import DepthRegistration
from idfslam.datasets.images.pairs import noticeable_delay
from idfslam.datasets.images.resampling import OneView
from idfslam.datasets.near_miss import Likeness
from idfslam.datasets.plausibility import common_scale
from idfslam.datasets.poses.truth import ReadTruth, optional_truth
from idfslam.datasets.provenance import ASSUMED, STATED, Provenance, provenance
from idfslam.datasets.time_stamps import in_seconds, increasing, units_per_second
from idfslam.datasets.topics import Topics
from idfslam.errors import ConfigError, FrameError, RecordingError
from idfslam.frame import FPS, Frame
from idfslam.frame_images import FARTHEST
from idfslam.geometry.camera import Camera
from idfslam.geometry.sensor_timing import SYNCHRONISED, SensorTiming

if TYPE_CHECKING:
    import trimesh

_PROBES = 5, 50  # frames, spread over a recording, of which one must be readable and have depth: at first, and if none is. Raised,
#    recordings with more damage, or with less depth, open. Chosen by hand

ReadImages = Callable[[int], tuple[NDArray[np.uint8], Depth | None]]
"""i -> colour (H, W, 3) BGR, depth (H, W) or None: this frame has no depth image."""


class FrameSource(Protocol):
    """A source of frames: a recording with all its N frames, or a live camera with the N frames so far."""

    @property
    def name(self) -> str: ...

    @property
    def camera(self) -> Camera: ...

    @property
    def timestamps(self) -> NDArray[np.float64]: ...  # (N,) [s]

    @property
    def ground_truth(self) -> NDArray[np.float64] | None: ...  # (N, 4, 4) camera-to-world, NaN: no pose


class Dataset(FrameSource, Protocol):
    """N frames in the order of time; `dataset[i]` raises FrameError if this one frame cannot be read.

    It may say more with attributes: see `depth_timestamps`, `timing`, `reading_threads` and `provenance`.
    """

    def __len__(self) -> int: ...

    def __getitem__(self, i: int) -> Frame: ...

    def surface(self) -> "trimesh.Trimesh | None": ...  # the true surface in the frame of ground_truth, if known


def reading_threads(dataset: Dataset) -> int:
    """How many threads should read its frames at once: its attribute `reading_threads`, by default one."""
    return int(getattr(dataset, "reading_threads", 1))


def depth_timestamps(dataset: FrameSource) -> NDArray[np.float64] | None:
    """(N,) [s] the stamps of its depth images, NaN where a frame has none: its attribute `depth_timestamps`; None: those of colour."""
    stamps: NDArray[np.float64] | None = getattr(dataset, "depth_timestamps", None)
    return stamps


def timing(dataset: FrameSource) -> SensorTiming:
    """The times of its sensor: its attribute `timing`; without it, a global shutter with colour and depth of one moment."""
    found: SensorTiming = getattr(dataset, "timing", SYNCHRONISED)
    return found


@dataclass(frozen=True)
class Reader:
    """One layout of recordings: its name for --format, its files in words, and functions that recognise and open it.

    likeness: what a folder of this layout must have, so that an error can name what one lacks; None for layouts of one file.
    """

    name: str
    layout: str
    recognises: Callable[[Path], bool]
    open: Callable[[Path, Calibration], Dataset]  # the calibration holds what the user and the camera files beside the images state
    open_topics: Callable[[Path, Calibration, Topics], Dataset] | None = None  # of topics by name; None: the layout has none
    likeness: Likeness | None = None


class Recording:
    """A recording whose images are read on request. One frame is read at once, to check that the recording can be used.

    Every colour image is a frame. One without a depth image, or whose depth image has no reading, has no depth.
    Raises RecordingError if the camera is unknown or does not fit the images, or if no frame can be read or has depth.
    """

    def __init__(
        self,
        name: str,
        read: ReadImages,
        *,
        timestamps: NDArray[np.float64],  # (N,) [s]
        ground_truth: ReadTruth | None,  # None: the layout has none
        calibration: Calibration,
        depth_camera: DepthCameraCalibration | None = None,  # None: depth is registered to colour
        random_access: bool = True,  # False: reading frames out of order is slow, as in videos
        stamps_source: str = STATED,  # ASSUMED with regular_stamps; else "file names", "timestamps.txt" ...
        depth_timestamps: NDArray[np.float64] | None = None,  # (N,) [s], NaN: the frame has no depth image. None: those of colour
    ) -> None:
        seconds = in_seconds(timestamps, name)
        usable = increasing(seconds, name)
        if usable is None:
            usable, stamps_source = regular_stamps(len(timestamps)), ASSUMED
        self.name, self.timestamps, self.random_access = name, usable, random_access
        self.depth_timestamps = (
            None if depth_timestamps is None else _beside(usable, seconds, depth_timestamps / units_per_second(timestamps))
        )
        self.timing = calibration.timing()
        self._read, self._read_truth, self._registered = read, ground_truth, depth_camera is None
        self._probed = 0, 0.0  # the frame that was read, and its median depth in units of the images
        self._sizes = colour, depth = self._probe()  # width, height [px]
        calibration = calibration.guessed(*colour)
        self.camera, self._scale, lens = calibration.camera(*colour, name), calibration.scale(name), calibration.distortion or ()
        self._one_view = OneView(colour, depth) if self._registered and colour != depth else None
        if self._one_view is not None:
            self.camera = self.camera.resized(*self._one_view.size)
        notes = () if self._one_view is None else (str(self._one_view),)
        delay = 0.0 if self.depth_timestamps is None else noticeable_delay(self.timestamps, self.depth_timestamps)
        self._reach = calibration.reach
        self._deformation, size = calibration.deformation, None if self._one_view is None else colour
        stated = calibration.source, self._scale, calibration.assumed, stamps_source, lens
        self.provenance = Provenance(*stated, self._deformation, size, delay, notes)
        self._refuse_far_depth()
        self._register = None if depth_camera is None else DepthRegistration(depth_camera, depth, self.camera, self._scale, name)
        self._undistort = Undistortion(self.camera, lens) if any(lens) else None

    @cached_property
    def ground_truth(self) -> NDArray[np.float64] | None:
        """(N, 4, 4) camera-to-world, NaN where a frame has none. It is read at its first use, and a fault in it is a warning."""
        return optional_truth(self._read_truth, count=len(self))

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, i: int) -> Frame:
        """Frame i, from -N to N-1; raises FrameError if its images are missing or damaged."""
        i = range(len(self))[i]
        bgr, raw = self._read(i)
        if raw is None:
            raw = np.zeros(self._sizes[1][::-1], np.uint16)
        if self._registered and self._one_view is None and _size(bgr) != _size(raw):
            raise self._two_sizes(i, _size(bgr), _size(raw))
        for kind, found, expected in (("", _size(bgr), self._sizes[0]), ("'s depth", _size(raw), self._sizes[1])):
            if found != expected:
                sizes = f"{found[0]}x{found[1]}, expected the recording's {expected[0]}x{expected[1]}"
                raise FrameError(f"{self.name}: frame {i}{kind} is {sizes}")
        if self._one_view is not None:
            bgr, raw = self._one_view(bgr, raw)
        if self._undistort is not None:
            bgr = self._undistort.colour(bgr)
            raw = self._undistort.depth(raw) if self._registered else raw
        if self._register is not None:
            raw = self._register(raw)
        depth = metres(raw, self._scale)
        depth = self._deformation.corrected(depth) if self._deformation else depth
        if self._reach is not None:
            depth[depth >= self._reach] = 0
        return Frame(i, float(self.timestamps[i]), rgb(bgr), depth, self.camera, self._depth_timestamp(i), self.timing)

    def _depth_timestamp(self, i: int) -> float | None:
        """[s] of frame i's depth image; None: that of colour."""
        if self.depth_timestamps is None or np.isnan(self.depth_timestamps[i]):
            return None
        return float(self.depth_timestamps[i])

    def surface(self) -> None:
        """None: files hold no surface."""

    def _with_depth(self, i: int) -> tuple[NDArray[np.uint8], Depth]:
        bgr, raw = self._read(i)
        if raw is None or not has_readings(raw):
            raise FrameError(f"{self.name}: frame {i} has no depth (all zero, 65535 or no number), expected readings of a depth camera")
        return bgr, raw

    def _probe(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Width and height [px] of colour and of depth, from one of a few frames with depth; if possible from one with equal sizes."""
        if not len(self):
            raise RecordingError(f"{self.name}: no frames")
        first_error: FrameError | None = None
        two_sizes: tuple[tuple[int, int], tuple[int, int]] | None = None
        places = np.arange(len(self))
        if self.depth_timestamps is not None and np.isfinite(self.depth_timestamps).any():
            places = np.flatnonzero(np.isfinite(self.depth_timestamps))  # of the frames that have a depth image
        tried: set[int] = set()
        for count in _PROBES:
            chosen = set(places[np.linspace(0, len(places) - 1, count, dtype=int)].tolist()) - tried
            tried |= chosen
            for i in sorted(chosen):
                try:
                    bgr, raw = self._with_depth(i)
                    colour, depth, self._probed = _size(bgr), _size(raw), (i, float(np.median(raw[readings(raw)])))
                    if not self._registered or colour == depth:
                        return colour, depth
                    if not OneView.fits(colour, depth):
                        raise self._two_sizes(i, colour, depth)
                    two_sizes = two_sizes or (colour, depth)
                except FrameError as error:
                    first_error = first_error or error
            if two_sizes is not None:
                return two_sizes
        raise RecordingError(str(first_error)) from first_error

    def _refuse_far_depth(self) -> None:
        """Raises RecordingError if the depth scale puts the frame that was read so far away that no frame could be used."""
        i, units = self._probed
        if units / self._scale > FARTHEST:
            other = common_scale(units, self._scale)
            mend = f"{other:g} (then it is {units / other:.2f} m)" if other else "in units per metre"
            found = f"the median depth of frame {i} is {units / self._scale:.4g} m with the depth scale of 1/{self._scale:g} m"
            raise RecordingError(f"{self.name}: {found}, expected at most {FARTHEST:g} m: give --camera.depth-scale {mend}")

    def _two_sizes(self, i: int, colour: tuple[int, int], depth: tuple[int, int]) -> FrameError:
        sizes = f"colour {colour[0]}x{colour[1]} and depth {depth[0]}x{depth[1]}"
        advice = f"register the depth to the colour camera, or describe the depth camera in {CAM_PARAMS} (docs: Recordings of your own)"
        return FrameError(f"{self.name}: frame {i} has {sizes}, expected one size: {advice}")


def _beside(usable: NDArray[np.float64], stamps: NDArray[np.float64], depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) [s] the stamps of depth. Where that of colour was replaced by a `usable` one, depth is taken to be of the same moment."""
    return np.where(np.isnan(depth) | (usable == stamps), depth, usable)


def _size(image: NDArray[Any]) -> tuple[int, int]:
    """Width, height [px]."""
    return image.shape[1], image.shape[0]


class Selection:
    """Every `stride`-th frame of a dataset from `start`, at most `frames` of them (None: all), numbered from 0.

    truth: False leaves the ground truth unread. Raises ConfigError if it begins beyond the dataset, or would have no frame.
    """

    def __init__(self, dataset: Dataset, *, start: int = 0, frames: int | None = None, stride: int = 1, truth: bool = True) -> None:
        count = len(dataset)
        if not 0 <= start < count:
            raise ConfigError(f"start {start} lies outside the {count} frames of {dataset.name}: choose 0 to {count - 1}")
        if stride < 1:
            raise ConfigError(f"stride {stride}, expected at least 1")
        indices = np.arange(start, count, min(stride, count))
        if frames is not None and frames < 1:
            found = f"frames {frames} from start {start} with stride {stride}"
            raise ConfigError(f"{found}: {dataset.name} has {count} frames, choose 1 to {len(indices)}")
        self._dataset, self._indices = dataset, indices[:frames]
        self.name, self.camera, self.reading_threads = dataset.name, dataset.camera, reading_threads(dataset)
        self.provenance, self.random_access = provenance(dataset), bool(getattr(dataset, "random_access", True))
        self.timestamps = dataset.timestamps[self._indices]
        stamps, self.timing = depth_timestamps(dataset), timing(dataset)
        self.depth_timestamps = None if stamps is None else stamps[self._indices]
        poses = dataset.ground_truth if truth else None
        self.ground_truth = None if poses is None else poses[self._indices]

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, i: int) -> Frame:
        i = range(len(self))[i]
        frame = self._dataset[int(self._indices[i])]
        return frame if frame.index == i else replace(frame, index=i)  # each new frame is checked, which takes time

    def surface(self) -> "trimesh.Trimesh | None":
        """The whole dataset's true surface, if known."""
        return self._dataset.surface()


def regular_stamps(count: int) -> NDArray[np.float64]:
    """(N,) stamps [s] at 30 Hz, for recordings without stamps: their `stamps_source` is ASSUMED."""
    return np.arange(count) / FPS
