"""A plain folder: rgb/ or color/ and depth/ with equal numbers, the camera in intrinsics.txt; depth in millimetres.

Poses and timestamps.txt are optional. Frames that timestamps.txt does not list are ignored: `idf-slam record` writes a frame's line after
its images, so that an interrupted recording is readable.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets import poses
from idfslam.datasets.calibration import (
    Calibration,
    DepthCameraCalibration,
    assumed_scale,
    read_cam_params,
    read_camera_file,
    read_depth_camera,
)
from idfslam.datasets.images import ImageFiles, numbered, paired
from idfslam.datasets.provenance import ASSUMED
from idfslam.datasets.recording import Reader, Recording, regular_stamps
from idfslam.datasets.stamps import STAMPS, read_stamps
from idfslam.errors import RecordingError

COLOUR_FOLDERS = ("rgb", "color", "colour")
_POSE_FOLDERS = ("pose", "poses")


def colour_folder(path: Path) -> Path | None:
    """The folder of colour images, if there is one."""
    return next((path / name for name in COLOUR_FOLDERS if (path / name).is_dir()), None)


def recognises(path: Path) -> bool:
    return colour_folder(path) is not None and (path / "depth").is_dir()


def open_folder(path: Path, override: Calibration) -> Recording:
    """Opens a folder. Poses, camera-to-world in metres, are read from pose/NUMBER.txt (4x4) or traj.txt (16 numbers a line)."""
    colour = colour_folder(path)
    if colour is None or not (path / "depth").is_dir():
        raise RecordingError(f"{path}: expected the folders rgb/ (or color/) and depth/")
    images, depths = numbered(colour), numbered(path / "depth")
    stamps = read_stamps(path / STAMPS, list(images))
    if stamps is not None:
        images, depths = ({number: files[number] for number in stamps if number in files} for files in (images, depths))
    pairs = paired(images, depths, path)
    calibration, depth_camera = calibrated(path, override)
    return Recording(
        path.name,
        ImageFiles(pairs),
        timestamps=regular_stamps(len(pairs)) if stamps is None else np.array([stamps[number] for number in images]),
        ground_truth=read_poses(path, list(images)),
        calibration=calibration,
        depth_camera=depth_camera,
        stamps_source=ASSUMED if stamps is None else STAMPS,
    )


def calibrated(path: Path, override: Calibration) -> tuple[Calibration, DepthCameraCalibration | None]:
    """The colour camera, from the user, cam_params.json and camera files; the depth camera, if depth is not registered. Depth in mm."""
    depth_camera = read_depth_camera(path)
    scale = Calibration(depth_scale=depth_camera.calibration.depth_scale if depth_camera else None)
    calibration = override.over(scale).over(read_cam_params(path)).over(read_camera_file(path))
    return calibration.over(assumed_scale(1000)), depth_camera


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


READER = Reader("folder", "rgb/ or color/, depth/, intrinsics.txt", recognises, open_folder)
