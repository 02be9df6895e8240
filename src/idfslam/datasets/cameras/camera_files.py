"""The files beside the images that state the camera: cam_params.json, then text as in `camera_text`, then JSON as in `camera_json`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from idfslam.datasets.cameras.calibration import Calibration, DepthCameraCalibration
from idfslam.datasets.cameras.camera_json import camera_of, read_camera_json, read_object
from idfslam.datasets.cameras.camera_text import parse_camera
from idfslam.errors import RecordingError
from idfslam.geometry.rigid_transform import RIGID, is_rigid
from idfslam.storage.text_file import read_text

CAM_PARAMS = "cam_params.json"
TEXT_FILES = (
    *("intrinsics.txt", "camera-intrinsics.txt", "camera_intrinsics.txt", "intrinsic.txt", "calibration.txt", "calib.txt", "camera.txt"),
    *("cam_K.txt", "K.txt"),
    *("cameras.txt", "camera_info.yaml", "camera.yaml", "calibration.yaml", "intrinsics.yaml", "ost.yaml"),
)
JSON_FILES = ("camera_intrinsic.json", "camera_intrinsics.json", "intrinsic.json", "intrinsics.json", "camera.json")
RTABMAP = "*calib/*.yaml"  # calib/ of RTAB-Map's export, with a file for each frame of which the first is read
BESIDE_A_FILE = (CAM_PARAMS, "intrinsics.txt")  # what is read in the folder of a recording that is one file: others may lie there too
LARGEST = 1 << 20  # [bytes] of a camera file; raised, other files of that name take longer to refuse. Chosen by hand


def read_beside(*folders: Path) -> Calibration:
    """What the files in these folders state, the first file first; empty without such files. Raises RecordingError for a malformed file."""
    depth_camera = read_depth_camera(*folders)
    scale = Calibration(depth_scale=depth_camera.calibration.depth_scale if depth_camera else None)
    text = next((found for folder in folders if (found := read_camera_file(folder)) != Calibration()), Calibration())
    return scale.over(read_cam_params(*folders)).over(text)


def read_beside_recording(path: Path) -> Calibration:
    """What the files in a recording's folder state; beside a recording that is one file, only those that can mean nothing else."""
    if path.is_dir():
        return read_beside(path)
    return read_cam_params(path.parent).over(read_camera_file(path.parent, BESIDE_A_FILE[1:]))


def read_cam_params(*folders: Path) -> Calibration:
    """Reads cam_params.json of the first folder that has one: {"camera": {w, h, fx, fy, cx, cy, scale[, distortion][, readout ...]}}."""
    path = _cam_params(folders)
    return Calibration() if path is None else read_camera_json(path)


def read_given(path: Path) -> Calibration:
    """Reads the camera file that a user names: cam_params.json under any name, or a text file. Raises RecordingError without a camera."""
    if path.is_dir():
        raise RecordingError(f"{path}: is a folder, expected the file of a camera, such as cam_params.json in it")
    if not path.is_file():
        raise RecordingError(f"{path}: no such file, expected a camera: `idf-slam calibrate RECORDING --out {path.name}` writes one")
    return _read(path, advice=": name another file")


def read_depth_camera(*folders: Path) -> DepthCameraCalibration | None:
    """Reads the depth camera from cam_params.json, {"depth_camera": like "camera", "T_colour_depth": 4x4}; None: depth is registered."""
    path = _cam_params(folders)
    if path is None or "depth_camera" not in (values := read_object(path)):
        return None
    try:
        T = np.array(values["T_colour_depth"], np.float64)
        rigid = T.shape == (4, 4) and bool(np.isfinite(T).all()) and bool(is_rigid(T[None], tolerance=RIGID)[0])
    except (KeyError, ValueError, TypeError, OverflowError):
        rigid = False
    if not rigid:
        raise RecordingError(f'{path}: expected "T_colour_depth" beside "depth_camera": a rigid 4x4 matrix, depth to colour camera, metres')
    return DepthCameraCalibration(camera_of({"camera": values["depth_camera"]}, path), T)


def read_camera_file(folder: Path, names: tuple[str, ...] = (*TEXT_FILES, *JSON_FILES)) -> Calibration:
    """Reads the first of these files that exists; empty without one. Raises RecordingError if it holds no camera."""
    path = next((folder / name for name in names if (folder / name).is_file()), None)
    if path is None and len(names) > 1:
        path = min(folder.glob(RTABMAP), default=None)
    return Calibration() if path is None else _read(path, advice=": remove the file")


def _read(path: Path, *, advice: str) -> Calibration:
    if (size := path.stat().st_size) > LARGEST:
        raise RecordingError(f"{path}: {size} bytes, expected the few lines of a camera{advice}")
    return read_camera_json(path) if path.suffix == ".json" else parse_camera(read_text(path), str(path))


def _cam_params(folders: Sequence[Path]) -> Path | None:
    return next((folder / CAM_PARAMS for folder in folders if (folder / CAM_PARAMS).is_file()), None)
