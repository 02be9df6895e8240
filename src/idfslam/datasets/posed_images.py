"""Recordings that state files, camera and pose of each frame, as programs for phones and for radiance fields write them."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.images.decoding import Depth, FilePair, ImageFiles, readings
from idfslam.datasets.images.depth_units import usual_scale
from idfslam.datasets.images.file_numbers import counting_numbers, name_stamps
from idfslam.datasets.images.pairs import warn_left_out
from idfslam.datasets.images.partners import of_frames, stamps_of, warn_without_own
from idfslam.datasets.images.resampling import downscaled_colour, limited_size, upscaled_depth
from idfslam.datasets.poses.truth import Truth
from idfslam.datasets.provenance import ASSUMED, STATED
from idfslam.datasets.recording import Recording, regular_stamps
from idfslam.datasets.time_stamps import in_seconds
from idfslam.errors import FrameError, RecordingError
from idfslam.geometry.transforms_json import OPENGL

_OTHER_CAMERA = 0.05  # [1] difference of a frame's focal length from the median, relative, from which on it is another camera's. Raised,
#    frames of two cameras are mixed; autofocus changes it by about 0.01. Chosen by hand


@dataclass(frozen=True, eq=False)
class FrameEntry:
    """What is stated about one frame; NaN where nothing is."""

    colour: Path
    depth: Path | None  # None: it has no depth image
    intrinsics: tuple[float, float, float, float]  # fx, fy, cx, cy [px], pixel centres at integer coordinates
    size: tuple[int, int] | None  # width, height [px] that the intrinsics are for; None: those of the colour image
    T_wc: NDArray[np.float64]  # (4, 4), x right, y down, z forward
    stamp: float = float("nan")  # in any unit
    confidence: Path | None = None  # an image, 0 where depth is guessed


def open_frames(
    path: Path,
    frames: Sequence[FrameEntry],
    stated: Calibration,
    source: str,
    *,
    depth_scale: float | None = None,
    distortion: tuple[float, ...] | None = None,
) -> Recording:
    """Opens frames in the order of their stamps, else of the numbers in their names.

    Frames without a colour image are left out, with a warning. One without a depth image has the nearest in time, if that is near.
    source: the file that states them. depth_scale: units per metre; None: floating-point numbers are metres, integers millimetres.
    Raises RecordingError if no frame is left.
    """
    frames = _ordered(_with_files(path, frames, source))
    rows = np.array([frame.intrinsics for frame in frames])
    camera = np.median(rows, 0)
    of_this_camera = ~(np.abs(rows[:, :2] / camera[:2] - 1) > _OTHER_CAMERA).any(1)
    warn_left_out(source, [f"{frames[i].colour.name} is of another camera" for i in np.flatnonzero(~of_this_camera)])
    frames = [frame for frame, same in zip(frames, of_this_camera) if same]
    stamps, stamps_source = _stamps(frames, source)
    has_depth = np.array([frame.depth is not None for frame in frames])
    warn_without_own(source, int(has_depth.sum()), len(frames))
    partner = np.where(has_depth, np.arange(len(frames)), -1) if stamps_source == ASSUMED else of_frames(has_depth, stamps)
    depths = [(frames[k].depth, frames[k].confidence) if k >= 0 else (None, None) for k in partner.tolist()]
    files: list[FilePair] = [(frame.colour, depth) for frame, (depth, _) in zip(frames, depths)]
    images = PosedImages(ImageFiles(files), [confidence for _, confidence in depths])
    recorded, size = images.sizes()
    images = replace(images, size=size)
    fx, fy, cx, cy = (float(value) if np.isfinite(value) else None for value in camera)
    calibration = Calibration(fx, fy, cx, cy, distortion=distortion, source=source)
    calibration = calibration.resized(frames[0].size or recorded, recorded)
    scale = Calibration(depth_scale=depth_scale, source=source) if depth_scale else None
    return Recording(
        path.name,
        images,
        timestamps=stamps,
        depth_timestamps=None if has_depth.all() else stamps_of(stamps, partner),
        stamps_source=stamps_source,
        ground_truth=lambda: Truth(np.stack([frame.T_wc for frame in frames]), source),
        calibration=stated.over(calibration).resized(recorded, size).over(scale or usual_scale(files)),
    )


@dataclass(frozen=True)
class PosedImages:
    """Called with i, returns colour and depth of frame i in one size (see `resampling` where they are recorded in two)."""

    files: ImageFiles
    confidence: Sequence[Path | None]
    size: tuple[int, int] | None = None  # width, height [px] of what is returned; needed for frames without a depth image

    def __call__(self, i: int) -> tuple[NDArray[np.uint8], Depth | None]:
        bgr, raw = self.files(i)
        if raw is None:
            whole = self.size in (None, (bgr.shape[1], bgr.shape[0]))
            return (bgr if whole or self.size is None else downscaled_colour(bgr, self.size)), None
        path = self.confidence[i]
        if path is not None:
            certain = ImageFiles([(path, path)]).colour(0)[..., 0] > 0
            if certain.shape == raw.shape:
                raw = raw.copy()
                raw[~(certain & readings(raw))] = 0
        if bgr.shape[:2] == raw.shape:
            return bgr, raw
        size = limited_size(bgr.shape[1], bgr.shape[0])
        return downscaled_colour(bgr, size), upscaled_depth(raw, size)

    def sizes(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Width and height [px] of the first readable colour image with depth, as it is recorded and as it is returned."""
        error: FrameError | None = None
        for i in [i for i, (_, depth) in enumerate(self.files.pairs) if depth is not None][:10]:
            try:
                (height, width, _), (rows, columns, _) = self.files.colour(i).shape, self(i)[0].shape
            except FrameError as first:
                error = error or first
            else:
                return (width, height), (columns, rows)
        raise RecordingError(str(error)) from error


def stated_number(values: Mapping[str, Any], *names: str) -> float:
    """The first of these numbers that is given; NaN if none is. Raises ValueError or TypeError if it is no number."""
    return next((float(values[name]) for name in names if values.get(name) is not None), float("nan"))


def from_opengl(matrix: Any) -> NDArray[np.float64]:
    """(4, 4) the pose of a camera with axes x right, y up, z backward, with this program's axes; NaN if it is no matrix."""
    try:
        T = np.array(matrix, np.float64)
    except (ValueError, TypeError, OverflowError):
        return np.full((4, 4), np.nan)
    T = T if T.shape != (3, 4) else np.vstack([T, [0, 0, 0, 1]])
    return T @ OPENGL if T.shape == (4, 4) else np.full((4, 4), np.nan)


def _with_files(path: Path, frames: Sequence[FrameEntry], source: str) -> list[FrameEntry]:
    problems, complete = [], []
    for frame in frames:
        file = frame.colour
        if os.path.isfile(file):
            complete.append(frame if frame.depth is None or os.path.isfile(frame.depth) else replace(frame, depth=None))
        else:
            problems.append(f"{file.relative_to(path) if file.is_relative_to(path) else file} is missing")
    if not any(frame.depth is not None for frame in complete):
        raise RecordingError(f"{source}: {problems[0] if problems else 'no frames with depth'}, expected colour and depth of each frame")
    warn_left_out(source, problems)
    return complete


def _ordered(frames: list[FrameEntry]) -> list[FrameEntry]:
    stamps = [frame.stamp for frame in frames]
    numbers = [float(text) if text else np.nan for text in counting_numbers([frame.colour.stem for frame in frames])]
    for keys in (stamps, numbers):
        if np.isfinite(keys).all() and len(set(keys)) == len(keys):
            return [frames[i] for i in np.argsort(keys, kind="stable")]
    return frames


def _stamps(frames: Sequence[FrameEntry], source: str) -> tuple[NDArray[np.float64], str]:
    stamps = np.array([frame.stamp for frame in frames])
    if np.all(np.diff(stamps) > 0) and np.isfinite(stamps).all():
        return in_seconds(stamps, source), STATED
    named = name_stamps([frame.colour.stem for frame in frames])
    return (regular_stamps(len(frames)), ASSUMED) if named is None else (named, "file names")
