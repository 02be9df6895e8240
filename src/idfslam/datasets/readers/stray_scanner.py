"""Stray Scanner (iPhone and iPad with LiDAR): rgb.mp4, depth/NNNNNN.png [mm], confidence/, camera_matrix.csv, odometry.csv.

Colour is 1920x1440 and depth 256x192; both become 640x480 (see `resampling`). Readings of low confidence, which ARKit guesses from the
image rather than measures, are left out. ARKit's poses in odometry.csv, already with x right, y down, z forward, are the ground truth.
"""

import csv
import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.cameras.camera_files import read_camera_file
from idfslam.datasets.images.confidence import MEDIUM
from idfslam.datasets.images.decoding import Depth, numbered, read_depth, read_values
from idfslam.datasets.images.partners import of_frames, stamps_of, warn_without_own
from idfslam.datasets.images.resampling import limited_size, upscaled_depth
from idfslam.datasets.images.video import VideoTrack
from idfslam.datasets.near_miss import Likeness, part
from idfslam.datasets.poses.pose_file import from_quaternions
from idfslam.datasets.poses.truth import Truth
from idfslam.datasets.recording import Reader, Recording
from idfslam.errors import FrameError, RecordingError
from idfslam.storage.text_file import read_text

log = logging.getLogger(__name__)

_COLUMNS = ("timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw")
_CAMERA = ("fx", "fy", "cx", "cy")  # of each frame, because of autofocus; later versions of the app write them


def recognises(path: Path) -> bool:
    return all((path / name).is_file() for name in ("rgb.mp4", "odometry.csv")) and (path / "depth").is_dir()


def open_stray_scanner(path: Path, stated: Calibration) -> Recording:
    """Opens an export. Video frame, depth image, confidence and odometry line with equal numbers are one frame.

    A frame without a depth image has the nearest in time, if that is near.
    """
    for name in ("rgb.mp4", "odometry.csv", "depth"):
        if not (path / name).exists():
            raise RecordingError(f"{path}: {name} is missing, expected an export of Stray Scanner: rgb.mp4, depth/, odometry.csv")
    track, depth = VideoTrack(path / "rgb.mp4"), numbered(path / "depth")
    odometry = read_odometry(path / "odometry.csv")
    numbers = [i for i in range(len(track)) if i in odometry.rows]
    has_depth = np.array([i in depth for i in numbers], bool)
    if not has_depth.any():
        found = f"{len(track)} frames in rgb.mp4, {len(depth)} images in depth/ and {len(odometry.rows)} lines in odometry.csv"
        raise RecordingError(f"{path}: {found}, expected equal numbers: export the recording again")
    if len(numbers) < len(track):
        log.warning("%s: %d frames of video, %d of which have a line in odometry.csv: these are read", path, len(track), len(numbers))
    warn_without_own(str(path), int(has_depth.sum()), len(numbers))
    rows = [odometry.rows[i] for i in numbers]
    calibration = stated.over(odometry.camera).over(read_camera_file(path, ("camera_matrix.csv",)))
    size, timestamps = limited_size(*track.size), odometry.table[rows, 0]
    partner = of_frames(has_depth, timestamps)
    depths = [numbers[k] if k >= 0 else None for k in partner.tolist()]
    return Recording(
        path.name,
        StrayImages(track, numbered(path / "confidence"), depth, numbers, depths, size),
        timestamps=timestamps,
        depth_timestamps=None if has_depth.all() else stamps_of(timestamps, partner),
        ground_truth=lambda: odometry.truth(path / "odometry.csv", rows),
        calibration=calibration.resized(track.size, size).over(Calibration(depth_scale=1000)),
        random_access=False,
    )


@dataclass(frozen=True)
class StrayImages:
    """Called with i, returns colour and depth of frame i in one size; None where it has no depth."""

    track: VideoTrack
    confidence: dict[float, Path]  # empty: every reading counts
    depth: dict[float, Path]
    numbers: list[int]  # of the video's frames
    depths: list[int | None]  # of their depth images
    size: tuple[int, int]  # width, height [px]

    def __call__(self, i: int) -> tuple[NDArray[np.uint8], Depth | None]:
        number, colour = self.depths[i], self.track.colour(self.numbers[i], self.size)
        if number is None:
            return colour, None
        raw = read_depth(self.depth[number])
        if self.confidence:
            raw = np.where(self._confidence(number, raw.shape) >= MEDIUM, raw, 0).astype(np.uint16)
        return colour, upscaled_depth(raw, self.size)

    def _confidence(self, number: int, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        path = self.confidence.get(number)
        image = None if path is None else read_values(path)
        if image is None or image.shape != shape:
            found = "missing" if path is None else "of another size than the depth image"
            raise FrameError(f"{path or self.depth[number]}: confidence of frame {number} is {found}: export the recording again")
        return np.asarray(image, np.uint8)


@dataclass(frozen=True, eq=False)
class Odometry:
    """The content of odometry.csv."""

    rows: dict[int, int]  # row in `table` by frame number
    table: NDArray[np.float64]  # (N, 9) the columns _COLUMNS; NaN where a pose is missing
    camera: Calibration  # the median over the frames; empty if they have none

    def truth(self, path: Path, rows: list[int]) -> Truth:
        """The poses in these rows of the table."""
        return Truth(from_quaternions(self.table[rows, 2:5], self.table[rows, 5:9]), str(path))


def read_odometry(path: Path) -> Odometry:
    """Reads odometry.csv; raises RecordingError if it is malformed."""
    reader = csv.DictReader(read_text(path).splitlines(), skipinitialspace=True)
    try:
        reader.fieldnames = names = [name.strip() for name in reader.fieldnames or ()]
        lines = list(reader)
    except csv.Error as error:
        raise RecordingError(f"{path}: {error}, expected lines of {', '.join(_COLUMNS)}") from error
    if missing := [name for name in _COLUMNS if name not in names]:
        raise RecordingError(f"{path}: no column {', '.join(missing)}, expected {', '.join(_COLUMNS)}")
    try:
        counters = [[float(line[name]) for name in _COLUMNS[:2]] for line in lines]
        table = np.array([[*row, *(_number(line[name]) for name in _COLUMNS[2:])] for row, line in zip(counters, lines)])
        cameras = [[float(line[name]) for name in _CAMERA] for line in lines] if set(_CAMERA) <= set(names) else []
    except (ValueError, TypeError) as error:
        raise RecordingError(f"{path}: {error}, expected numbers in {', '.join(_COLUMNS)}") from error
    if not len(table):
        raise RecordingError(f"{path}: empty, expected a line for each frame")
    table = table.reshape(-1, len(_COLUMNS))
    if not np.isfinite(table[:, :2]).all():
        raise RecordingError(f"{path}: a timestamp or a frame is not finite, expected numbers: export the recording again")
    rows = {int(frame): row for row, frame in enumerate(table[:, 1])}
    if not cameras:
        return Odometry(rows, table, Calibration())
    fx, fy, cx, cy = (float(value) for value in np.median(cameras, 0))
    return Odometry(rows, table, Calibration(fx, fy, cx, cy, source=str(path)))


def _number(text: str | None) -> float:
    """A number; NaN if the text is none."""
    try:
        return float(text or "nan")
    except ValueError:
        return float("nan")


READER = Reader(
    "stray",
    "rgb.mp4, depth/, odometry.csv of Stray Scanner",
    recognises,
    open_stray_scanner,
    likeness=Likeness("a Stray Scanner folder", (part("rgb.mp4"), part("depth", "depth/"), part("odometry.csv"))),
)
