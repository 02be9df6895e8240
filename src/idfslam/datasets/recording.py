"""What every reader yields: a recording opened lazily, and a selection of its frames."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.calibration import Calibration, DepthCamera
from idfslam.datasets.depth_registration import Registration
from idfslam.datasets.images import Depth, Undistortion, has_readings, metres, rgb
from idfslam.datasets.topics import Topics
from idfslam.errors import ConfigError, FrameError, RecordingError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera

if TYPE_CHECKING:
    import trimesh

FPS = 30.0  # of recordings without stamps
_PROBES = 5  # a recording is unusable if none of so many frames spread over it can be read

ReadImages = Callable[[int], tuple[NDArray[np.uint8], Depth]]  # i -> colour (H, W, 3) BGR, depth (H, W)


class FrameSource(Protocol):
    """What is known of where frames come from: of all N frames of a recording, or of the N that a live camera has given so far."""

    @property
    def name(self) -> str: ...

    @property
    def camera(self) -> Camera: ...

    @property
    def timestamps(self) -> NDArray[np.float64]: ...  # (N,) [s]

    @property
    def ground_truth(self) -> NDArray[np.float64] | None: ...  # (N, 4, 4) camera-to-world, NaN where a frame has none


class Dataset(FrameSource, Protocol):
    """N frames in the order of time; `dataset[i]` raises FrameError for one bad frame."""

    def __len__(self) -> int: ...

    def __getitem__(self, i: int) -> Frame: ...

    def surface(self) -> "trimesh.Trimesh | None": ...  # the true surface in the frame of ground_truth, where it is known


def readers(dataset: Dataset) -> int:
    """How many threads may read its frames at once: what its attribute `readers` says, or one."""
    return int(getattr(dataset, "readers", 1))


@dataclass(frozen=True)
class Reader:
    """One layout: its name for --format, what it looks like, whether a path has it, and how to open it."""

    name: str
    layout: str
    recognises: Callable[[Path], bool]
    open: Callable[[Path, Calibration], Dataset]  # the calibration is the user's override
    open_topics: Callable[[Path, Calibration, Topics], Dataset] | None = None  # of layouts that have topics, which the user may name


class Recording:
    """A recording whose images are decoded when asked for; one frame is read at opening to see that it can be used.

    Raises RecordingError where the camera is unknown or does not fit, or no frame can be read.
    """

    def __init__(
        self,
        name: str,
        read: ReadImages,
        *,
        timestamps: NDArray[np.float64],  # (N,) [s]
        ground_truth: NDArray[np.float64] | None,  # (N, 4, 4) camera-to-world
        calibration: Calibration,
        depth_camera: DepthCamera | None = None,  # None: depth is registered to colour
    ) -> None:
        self.name, self.timestamps, self.ground_truth = name, timestamps, ground_truth
        self._read, self._registered = read, depth_camera is None
        colour, depth = self._probe()
        self.camera = calibration.camera(*colour, name)
        self._scale = calibration.scale(name)
        self._size = depth  # width, height [px] of the depth images
        self._register = None if depth_camera is None else Registration(depth_camera, depth, self.camera, self._scale, name)
        distorted = calibration.distortion is not None and any(calibration.distortion)
        self._undistort = Undistortion(self.camera, calibration.distortion or ()) if distorted else None

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, i: int) -> Frame:
        """Frame i, from -N to N-1; raises FrameError where its images are missing, damaged or without depth."""
        i = range(len(self))[i]
        bgr, raw = self._checked(i)
        for kind, found, expected in (("", _size(bgr), (self.camera.width, self.camera.height)), ("'s depth", _size(raw), self._size)):
            if found != expected:
                sizes = f"{found[0]}x{found[1]}, expected the recording's {expected[0]}x{expected[1]}"
                raise FrameError(f"{self.name}: frame {i}{kind} is {sizes}")
        if self._undistort is not None:
            bgr = self._undistort.colour(bgr)
            raw = self._undistort.depth(raw) if self._registered else raw
        if self._register is not None:
            raw = self._register(raw)
        return Frame(i, float(self.timestamps[i]), rgb(bgr), metres(raw, self._scale), self.camera)

    def surface(self) -> None:
        """Unknown: files hold no surface."""

    def _checked(self, i: int) -> tuple[NDArray[np.uint8], Depth]:
        bgr, raw = self._read(i)
        if self._registered and bgr.shape[:2] != raw.shape:
            sizes = f"colour {bgr.shape[1]}x{bgr.shape[0]} and depth {raw.shape[1]}x{raw.shape[0]}"
            raise FrameError(f"{self.name}: frame {i} has {sizes}, expected one size: register the depth to the colour camera")
        if not has_readings(raw):
            raise FrameError(f"{self.name}: frame {i} has no depth (all zero), expected readings of a depth camera")
        return bgr, raw

    def _probe(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Width and height [px] of colour and depth by the first of a few frames that can be read."""
        if not len(self):
            raise RecordingError(f"{self.name}: no frames")
        first: FrameError | None = None
        for i in np.unique(np.linspace(0, len(self) - 1, _PROBES, dtype=int)):
            try:
                bgr, raw = self._checked(int(i))
            except FrameError as error:
                first = first or error
            else:
                return _size(bgr), _size(raw)
        raise RecordingError(str(first)) from first


def _size(image: NDArray[Any]) -> tuple[int, int]:
    """Width, height [px]."""
    return image.shape[1], image.shape[0]


class Selection:
    """Every `stride`-th frame of a dataset from `start`, at most to `frames` of them, numbered from 0.

    Raises ConfigError where it reaches beyond the dataset.
    """

    def __init__(self, dataset: Dataset, *, start: int = 0, frames: int | None = None, stride: int = 1) -> None:
        count = len(dataset)
        if not 0 <= start < count:
            raise ConfigError(f"start {start} lies outside the {count} frames of {dataset.name}: choose 0 to {count - 1}")
        if stride < 1:
            raise ConfigError(f"stride {stride}, expected at least 1")
        indices = np.arange(start, count, stride)
        if frames is not None and not 1 <= frames <= len(indices):
            found = f"frames {frames} from start {start} with stride {stride}"
            raise ConfigError(f"{found}: {dataset.name} has {count} frames, choose 1 to {len(indices)}")
        self._dataset, self._indices = dataset, indices[:frames]
        self.name, self.camera, self.readers = dataset.name, dataset.camera, readers(dataset)
        self.timestamps = dataset.timestamps[self._indices]
        truth = dataset.ground_truth
        self.ground_truth = None if truth is None else truth[self._indices]

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, i: int) -> Frame:
        i = range(len(self))[i]
        return replace(self._dataset[int(self._indices[i])], index=i)

    def surface(self) -> "trimesh.Trimesh | None":
        """The whole dataset's true surface, where it is known."""
        return self._dataset.surface()


def regular_stamps(count: int) -> NDArray[np.float64]:
    """(N,) [s]: index / 30 Hz, for recordings without stamps."""
    return np.arange(count) / FPS
