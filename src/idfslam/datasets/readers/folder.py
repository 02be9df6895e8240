"""A plain folder: rgb/ or color/ and depth/, or both kinds of file in one folder; the camera in intrinsics.txt; depth in millimetres.

Colour and depth images belong together by the numbers in their names; names that are time stamps give the stamps (`images/pairs.py`).

Poses and timestamps.txt are optional. Frames that timestamps.txt does not list are ignored: `idf-slam record` writes a frame's line after
its images, so that an interrupted recording is readable.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.cameras.camera_files import read_depth_camera
from idfslam.datasets.images.decoding import ImageFiles, numbered
from idfslam.datasets.images.depth_units import usual_scale
from idfslam.datasets.images.folders import find_images, has_colour, has_depth
from idfslam.datasets.images.pairs import Pairs, numbered_series, pair_images
from idfslam.datasets.near_miss import Likeness, Part
from idfslam.datasets.poses.pose_file import read_pose_file
from idfslam.datasets.poses.truth import Truth, read_matrix, read_stamped
from idfslam.datasets.provenance import ASSUMED
from idfslam.datasets.recording import FPS, Reader, Recording
from idfslam.datasets.stamps import STAMPS, read_depth_stamps, read_stamps
from idfslam.errors import RecordingError

COLOUR_FOLDERS = ("rgb", "color", "colour")
_POSE_FOLDERS = ("pose", "poses")
_POSE_FILES = ("traj.txt", "groundtruth.txt")


def recognises(path: Path) -> bool:
    return find_images(path) is not None


def open_folder(path: Path, stated: Calibration) -> Recording:
    """Opens a folder. Poses, camera-to-world in metres, are read from pose/NUMBER.txt (4x4) or traj.txt (16 numbers a line)."""
    found = find_images(path)
    if found is None:
        raise RecordingError(f"{path}: expected the folders rgb/ (or color/) and depth/, or colour and depth images in one folder")
    images, depths = numbered_series(found.colour, found.depth, path)
    stamps = read_stamps(path / STAMPS, sorted(images.keys() | depths.keys()), list(images), list(depths))
    if stamps is not None:
        colours = len(images)
        images, depths = ({number: files[number] for number in stamps if number in files} for files in (images, depths))
        if colours and not images:
            problem = f"names none of the {colours} colour images"
            raise RecordingError(f"{path / STAMPS}: {problem}, expected lines of frame and stamp: complete or remove the file")
    pairs = pair_images(images, depths, path)
    timestamps, source = pairs.places / FPS, ASSUMED
    if stamps is not None:
        timestamps, source = np.array([stamps[number] for number in pairs.numbers]), STAMPS
    elif pairs.stamps is not None:
        timestamps, source = pairs.stamps, "file names"
    shown = pairs if source == ASSUMED else pairs.with_nearest_depth(timestamps)
    depth_timestamps = shown.depth_timestamps(timestamps)
    if (listed := read_depth_stamps(path / STAMPS)) and pairs.has_depth.all():
        depth_timestamps = np.array([listed.get(number, np.nan) for number in pairs.numbers])
        depth_timestamps = np.where(np.isfinite(depth_timestamps), depth_timestamps, timestamps)
    return Recording(
        path.name,
        ImageFiles(shown.files),
        timestamps=timestamps,
        stamps_source=source,
        depth_timestamps=depth_timestamps,
        ground_truth=lambda: read_poses(path, pairs, timestamps),
        calibration=stated.over(usual_scale(pairs.files)),
        depth_camera=read_depth_camera(path),
    )


def read_poses(path: Path, frames: Pairs, timestamps: NDArray[np.float64]) -> Truth | None:
    """The poses from pose/ or poses/, one file a frame, else from traj.txt or groundtruth.txt; None without any. timestamps: (N,) [s]."""
    folder = next((path / name for name in _POSE_FOLDERS if (path / name).is_dir()), None)
    if folder is not None:
        return read_pose_files(folder, "*.txt", frames)
    file = next((path / name for name in _POSE_FILES if (path / name).is_file()), None)
    return None if file is None else read_trajectory(file, frames, timestamps)


def read_pose_files(folder: Path, pattern: str, frames: Pairs) -> Truth | None:
    """The poses from one file for each frame number; None if there are no files. A frame without a file has no pose."""
    files = numbered(folder, pattern, suffixes=frozenset({".txt"}))
    if not files:
        return None
    T_wc, problems = np.full((len(frames), 4, 4), np.nan), []
    for i, number in enumerate(frames.numbers):
        try:
            if number not in files:
                raise RecordingError(f"{folder}: no pose for frame {number:.15g}")
            T_wc[i] = read_matrix(files[number])
        except OSError as error:
            problems.append(f"{files[number]}: {error.strerror}")
        except RecordingError as error:
            problems.append(str(error))
    return Truth(T_wc, str(folder), problems)


def read_trajectory(path: Path, frames: Pairs, timestamps: NDArray[np.float64]) -> Truth | None:
    """Poses (N, 4, 4) from a file with stamps [s], or one for each frame, with or without those left out; None without the file."""
    if not path.is_file():
        return None
    file = read_pose_file(path)
    if file.timestamps is not None:
        return read_stamped(path, timestamps)
    T_wc = file.T_wc[frames.places] if len(file.T_wc) == frames.frames else file.T_wc
    if len(T_wc) != len(frames) and len(T_wc) == frames.has_depth.sum():  # those of the frames with depth
        T_wc = np.full((len(frames), 4, 4), np.nan)
        T_wc[frames.has_depth] = file.T_wc
    return Truth(T_wc, str(path), file.problems)


READER = Reader(
    "folder",
    "rgb/ or color/ and depth/, or 0001_color.png and 0001_depth.png; intrinsics.txt",
    recognises,
    open_folder,
    likeness=Likeness("a folder of images", (Part("colour images (rgb/ or color/)", has_colour), Part("depth images (depth/)", has_depth))),
)
