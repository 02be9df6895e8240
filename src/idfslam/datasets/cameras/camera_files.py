"""The files beside the images that state the camera: cam_params.json, then text files as in `camera_text`, then Open3D's and other JSON."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from idfslam.datasets.cameras.calibration import TIMES, Calibration, DepthCameraCalibration
from idfslam.datasets.cameras.camera_text import DEPTH_SCALES, checked_distortion, from_matrix, parse_camera, units_per_metre
from idfslam.errors import ConfigError, RecordingError
from idfslam.geometry.rigid_transform import RIGID, is_rigid
from idfslam.geometry.sensor_timing import UNKNOWN, SensorTiming
from idfslam.sensing import depth_deformation
from idfslam.sensing.depth_deformation import DepthDeformation
from idfslam.storage.json_file import read_json
from idfslam.storage.plain_values import shown
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
DEFORMATION = "depth_deformation"
LARGEST_DEFORMATION = 0.2  # [1] of each of its numbers; raised, more nonsense passes. Sensors have a few per cent at most
_FORM = '{"camera": {"w", "h", "fx", "fy", "cx", "cy", "scale"}} with numbers'
_MATRICES = ("intrinsic_matrix", "camera_matrix", "K", "intrinsics", "intrinsic")
_NAMES = {  # of a camera's values in JSON files
    "fx": ("fx", "fl_x"),
    "fy": ("fy", "fl_y"),
    "cx": ("cx", "ppx"),
    "cy": ("cy", "ppy"),
    "width": ("width", "w", "image_width"),
    "height": ("height", "h", "image_height"),
    "scale": (*DEPTH_SCALES, "scale"),
    "distortion": ("distortion", "distortion_coefficients", "dist_coeffs", "coeffs", "D"),
}


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
    return Calibration() if path is None else _read_cam_params(path)


def read_given(path: Path) -> Calibration:
    """Reads the camera file that a user names: cam_params.json under any name, or a text file. Raises RecordingError without a camera."""
    if not path.is_file():
        raise RecordingError(f"{path}: no such file, expected a camera: `idf-slam calibrate RECORDING --out {path.name}` writes one")
    if path.stat().st_size > LARGEST:
        raise RecordingError(f"{path}: {path.stat().st_size} bytes, expected the few lines of a camera")
    return _read_cam_params(path) if path.suffix == ".json" else parse_camera(read_text(path), str(path))


def _read_cam_params(path: Path) -> Calibration:
    values = _json(path, f"expected {_FORM}")
    if not {"camera", "fx", *TIMES} & values.keys():
        return read_camera_json(path)
    return _camera_of({"camera": values} if "camera" not in values else values, "camera", path)


def read_depth_camera(*folders: Path) -> DepthCameraCalibration | None:
    """Reads the depth camera from cam_params.json, {"depth_camera": like "camera", "T_colour_depth": 4x4}; None: depth is registered."""
    path = _cam_params(folders)
    if path is None or "depth_camera" not in (values := _json(path, f"expected {_FORM}")):
        return None
    try:
        T = np.array(values["T_colour_depth"], np.float64)
        rigid = T.shape == (4, 4) and bool(np.isfinite(T).all()) and bool(is_rigid(T[None], tolerance=RIGID)[0])
    except (KeyError, ValueError, TypeError, OverflowError):
        rigid = False
    if not rigid:
        raise RecordingError(f'{path}: expected "T_colour_depth" beside "depth_camera": a rigid 4x4 matrix, depth to colour camera, metres')
    return DepthCameraCalibration(_camera_of(values, "depth_camera", path), T)


def read_camera_file(folder: Path, names: tuple[str, ...] = (*TEXT_FILES, *JSON_FILES)) -> Calibration:
    """Reads the first of these files that exists; empty without one. Raises RecordingError if it holds no camera."""
    path = next((folder / name for name in names if (folder / name).is_file()), None)
    if path is None and len(names) > 1:
        path = min(folder.glob(RTABMAP), default=None)
    if path is None:
        return Calibration()
    if (size := path.stat().st_size) > LARGEST:
        raise RecordingError(f"{path}: {size} bytes, expected the few lines of a camera: remove the file")
    return read_camera_json(path) if path.suffix == ".json" else parse_camera(read_text(path), str(path))


def read_camera_json(path: Path) -> Calibration:
    """Reads a camera from JSON: a matrix K as Open3D writes it (`intrinsic_matrix`, by columns) or by rows, or fx, fy, cx, cy.

    A depth scale below 0.1 is taken as metres per unit, as RealSense's SDK gives it. Raises RecordingError if there is no camera.
    """
    expected = "expected width, height and intrinsic_matrix of 9 numbers, or fx, fy, cx, cy"
    whole: Mapping[str, Any] = _json(path, expected)
    values = whole
    for key in ("camera", "color", "colour", "rgb", "intrinsics", "intrinsic"):
        if isinstance(values.get(key), dict):
            values = values[key]
    if values is not whole:  # the scale may stand beside the camera
        values = {name: whole[name] for name in _NAMES["scale"] if name in whole} | dict(values)
    given = {key: values[name] for key, names in _NAMES.items() for name in reversed(names) if values.get(name) is not None}
    try:
        matrix = next((values[name] for name in _MATRICES if isinstance(values.get(name), list)), None)
        if matrix is not None:
            camera = from_matrix(np.array(matrix, np.float64).reshape(3, 3), str(path))
        else:
            fx, fy, cx, cy = (float(given[key]) for key in ("fx", "fy", "cx", "cy"))
            camera = Calibration(fx, fy, cx, cy, source=str(path))
        width, height = (int(given[key]) if key in given else None for key in ("width", "height"))
        scale = float(given["scale"]) if "scale" in given else None
        distortion = [float(value) for value in given.get("distortion", ())]
        times = _times(values, path)
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise RecordingError(f"{path}: {type(error).__name__} {error}, {expected}") from error
    lens = checked_distortion(distortion, str(path))
    return replace(camera, width=width, height=height, distortion=lens, depth_scale=units_per_metre(scale)).with_times(times)


def _cam_params(folders: Sequence[Path]) -> Path | None:
    return next((folder / CAM_PARAMS for folder in folders if (folder / CAM_PARAMS).is_file()), None)


def _json(path: Path, expected: str) -> dict[str, Any]:
    values = read_json(path, error=RecordingError, expected=expected.removeprefix("expected "))
    if not isinstance(values, dict):
        raise RecordingError(f"{path}: {type(values).__name__}, {expected}")
    return values


def _camera_of(values: Mapping[str, Any], key: str, path: Path) -> Calibration:
    try:
        values = values[key]
        times = _times(values, path)
        if times != UNKNOWN and not any(name in values for name in ("fx", "fy", "cx", "cy")):
            return Calibration(source=str(path)).with_times(times)  # another source states the camera
        fx, fy, cx, cy = (float(values[key]) for key in ("fx", "fy", "cx", "cy"))
        width, height = (int(values[key]) if key in values else None for key in ("w", "h"))
        name = next((name for name in ("scale", *DEPTH_SCALES) if values.get(name) is not None), None)
        scale = None if name is None else units_per_metre(float(values[name]))
        distortion = [float(value) for value in values.get("distortion") or ()]
        deformation = _deformation(values.get(DEFORMATION))
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise RecordingError(f"{path}: {type(error).__name__} {error}, expected {_FORM}") from error
    lens = checked_distortion(distortion, str(path))
    return Calibration(fx, fy, cx, cy, width, height, lens, scale, deformation, source=str(path)).with_times(times)


def _deformation(values: Any) -> DepthDeformation | None:
    """The deformation of depth that is stated. Raises ValueError or TypeError for other names, and for what is no small number."""
    if values is None:
        return None
    if not isinstance(values, dict) or not values.keys() <= set(depth_deformation.NAMES):
        raise ValueError(f"{DEFORMATION} {shown(values)} with other names than {', '.join(depth_deformation.NAMES)}")
    numbers = {name: float(value) for name, value in values.items()}
    if not all(math.isfinite(value) and abs(value) <= LARGEST_DEFORMATION for value in numbers.values()):
        raise ValueError(f"{DEFORMATION} {shown(values)} beyond {LARGEST_DEFORMATION}")
    return DepthDeformation(**numbers)


def _times(values: Mapping[str, Any], path: Path) -> SensorTiming:
    """The times of the sensor that are stated. Raises ValueError or TypeError if one is no number, RecordingError if it is no sensor's."""
    numbers = (None if values.get(name) is None else float(values[name]) for name in TIMES)
    try:
        return SensorTiming(*numbers)
    except ConfigError as error:
        raise RecordingError(f"{path}: {error}") from error
