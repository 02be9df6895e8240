"""A plain folder: rgb/ or color/ and depth/, or both kinds of file in one folder; the camera in intrinsics.txt; depth in millimetres.

Colour and depth images belong together by the numbers in their names; names that are time stamps give the stamps (see `image_pairs`).

Poses and timestamps.txt are optional. Frames that timestamps.txt does not list are ignored: `idf-slam record` writes a frame's line after
its images, so that an interrupted recording is readable.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets import poses
from idfslam.datasets.calibration import Calibration, DepthCameraCalibration, assumed_scale
from idfslam.datasets.camera_files import read_beside, read_depth_camera
from idfslam.datasets.image_folders import find_images
from idfslam.datasets.image_pairs import pair_images
from idfslam.datasets.images import ImageFiles, by_number, holds_floats, numbered
from idfslam.datasets.provenance import ASSUMED
from idfslam.datasets.recording import Reader, Recording, regular_stamps
from idfslam.datasets.stamps import STAMPS, read_stamps
from idfslam.errors import RecordingError

COLOUR_FOLDERS = ("rgb", "color", "colour")
_POSE_FOLDERS = ("pose", "poses")


def recognises(path: Path) -> bool:
    return find_images(path) is not None


def open_folder(path: Path, override: Calibration) -> Recording:
    """Opens a folder. Poses, camera-to-world in metres, are read from pose/NUMBER.txt (4x4) or traj.txt (16 numbers a line)."""
    found = find_images(path)
    if found is None:
        raise RecordingError(f"{path}: expected the folders rgb/ (or color/) and depth/, or colour and depth images in one folder")
    images, depths = by_number(found.colour), by_number(found.depth)
    stamps = read_stamps(path / STAMPS, list(images))
    if stamps is not None:
        images, depths = ({number: files[number] for number in stamps if number in files} for files in (images, depths))
    pairs = pair_images(images, depths, path)
    timestamps, source = regular_stamps(len(pairs.files)), ASSUMED
    if stamps is not None:
        timestamps, source = np.array([stamps[number] for number in pairs.numbers]), STAMPS
    elif pairs.stamps is not None:
        timestamps, source = pairs.stamps, "file names"
    calibration, depth_camera = calibrated(path, override)
    return Recording(
        path.name,
        ImageFiles(pairs.files),
        timestamps=timestamps,
        stamps_source=source,
        ground_truth=read_poses(path, pairs.numbers),
        calibration=calibration.over(usual_scale(pairs.files)),
        depth_camera=depth_camera,
    )


def usual_scale(pairs: Sequence[tuple[Path, Path]]) -> Calibration:
    """The depth scale where nobody states one: integers are millimetres, floating-point numbers are metres. pairs: colour and depth."""
    return assumed_scale(1, "float images are metres") if pairs and holds_floats(*pairs[0]) else assumed_scale(1000)


def calibrated(path: Path, override: Calibration) -> tuple[Calibration, DepthCameraCalibration | None]:
    """The colour camera, from the user, cam_params.json and camera files; the depth camera, if depth is not registered."""
    depth_camera = read_depth_camera(path)
    return override.over(read_beside(path)), depth_camera


def read_poses(path: Path, numbers: list[float]) -> NDArray[np.float64] | None:
    """(N, 4, 4) the poses of the frames with these numbers, from pose/ or poses/, else from traj.txt; None without either."""
    folder = next((path / name for name in _POSE_FOLDERS if (path / name).is_dir()), None)
    if folder is not None:
        return read_pose_files(folder, "*.txt", numbers)
    return read_trajectory(path / "traj.txt", len(numbers))


def read_pose_files(folder: Path, pattern: str, numbers: list[float]) -> NDArray[np.float64] | None:
    """(N, 4, 4) the poses from one file for each frame number; None if there are no files."""
    files = numbered(folder, pattern, suffixes=frozenset({".txt"}))
    if not files:
        return None
    if unpaired := sorted(files.keys() ^ set(numbers)):
        found = f"{len(files)} poses for {len(numbers)} frames, number {unpaired[0]:.15g} has no partner"
        raise RecordingError(f"{folder}: {found}: expected one for each, with equal numbers: complete or remove them")
    paths = list(files.values())
    return poses.checked(np.stack([poses.read_matrix(file) for file in paths]), count=len(numbers), source=lambda i: str(paths[i]))


def read_trajectory(path: Path, count: int) -> NDArray[np.float64] | None:
    """(count, 4, 4) the poses from lines of 16 numbers; None without the file."""
    return poses.checked(poses.read_matrices(path), count=count, source=lambda _: str(path)) if path.is_file() else None


READER = Reader("folder", "rgb/ or color/ and depth/, or 0001_color.png and 0001_depth.png; intrinsics.txt", recognises, open_folder)
