"""A plain folder: rgb/ or color/ and depth/ with equal numbers, the camera in intrinsics.txt, optional poses; depth in millimetres."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets import poses
from idfslam.datasets.calibration import Calibration, read_cam_params, read_camera_file
from idfslam.datasets.images import ImageFiles, numbered, paired
from idfslam.datasets.recording import Reader, Recording, regular_stamps
from idfslam.errors import RecordingError

COLOUR_FOLDERS = ("rgb", "color", "colour")
_POSE_FOLDERS = ("pose", "poses")


def colour_folder(path: Path) -> Path | None:
    """The folder of colour images, if there is one."""
    return next((path / name for name in COLOUR_FOLDERS if (path / name).is_dir()), None)


def recognises(path: Path) -> bool:
    return colour_folder(path) is not None and (path / "depth").is_dir()


def open_folder(path: Path, override: Calibration) -> Recording:
    """Poses, where there are any, lie in pose/NUMBER.txt (4x4) or traj.txt (16 numbers a line), camera-to-world in metres."""
    colour = colour_folder(path)
    if colour is None or not (path / "depth").is_dir():
        raise RecordingError(f"{path}: expected the folders rgb/ (or color/) and depth/")
    pairs = paired(numbered(colour), numbered(path / "depth"), path)
    calibration = override.over(read_cam_params(path)).over(read_camera_file(path)).over(Calibration(depth_scale=1000))
    return Recording(
        path.name,
        ImageFiles(pairs),
        timestamps=regular_stamps(len(pairs)),
        ground_truth=read_poses(path, len(pairs)),
        calibration=calibration,
    )


def read_poses(path: Path, count: int) -> NDArray[np.float64] | None:
    """(count, 4, 4) from pose/ or poses/, else from traj.txt, else None."""
    folder = next((path / name for name in _POSE_FOLDERS if (path / name).is_dir()), None)
    if folder is not None:
        return read_pose_files(sorted(folder.glob("*.txt"), key=lambda file: (len(file.stem), file.stem)), count)
    trajectory = path / "traj.txt"
    return poses.checked(poses.read_matrices(trajectory), count=count, source=lambda _: str(trajectory)) if trajectory.is_file() else None


def read_pose_files(files: list[Path], count: int) -> NDArray[np.float64] | None:
    """(count, 4, 4) from one file a frame; None where there is no file at all."""
    if not files:
        return None
    matrices = np.stack([poses.read_matrix(file) for file in files])
    return poses.checked(matrices, count=count, source=lambda i: str(files[i] if len(files) == count else files[i].parent))


READER = Reader("folder", "rgb/ or color/, depth/, intrinsics.txt", recognises, open_folder)
