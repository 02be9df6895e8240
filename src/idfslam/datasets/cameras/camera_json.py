"""A pinhole camera as JSON, in the forms in which programs write it.

fx, fy, cx, cy or a matrix K, by columns as Open3D writes it (`intrinsic_matrix`) or by rows; image size, distortion and depth scale under
their usual names. They stand in the outermost object or in one of its own, such as "camera" in cam_params.json. The times of the sensor and
the deformation of depth, which `idf-slam calibrate` writes, may stand beside them.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from idfslam.datasets.cameras.calibration import TIMES, Calibration
from idfslam.datasets.cameras.camera_text import DEPTH_SCALES, checked_distortion, from_matrix, units_per_metre
from idfslam.errors import ConfigError, RecordingError
from idfslam.geometry.sensor_timing import UNKNOWN, SensorTiming
from idfslam.sensing import depth_deformation
from idfslam.sensing.depth_deformation import DepthDeformation
from idfslam.storage.json_file import read_json
from idfslam.storage.plain_values import fault, shown

DEFORMATION = "depth_deformation"
LARGEST_DEFORMATION = 0.2  # [1] of each of its numbers; raised, more nonsense passes. Sensors have a few per cent at most
EXPECTED = "width, height and intrinsic_matrix of 9 numbers, or fx, fy, cx, cy with w, h and scale"
_OBJECTS = ("camera", "color", "colour", "rgb", "intrinsics", "intrinsic")  # in which the values may stand
_MATRICES = ("intrinsic_matrix", "camera_matrix", "K", "intrinsics", "intrinsic")
_NAMES = {  # of a camera's values; the first that is there counts
    "fx": ("fx", "fl_x"),
    "fy": ("fy", "fl_y"),
    "cx": ("cx", "ppx"),
    "cy": ("cy", "ppy"),
    "width": ("width", "w", "image_width"),
    "height": ("height", "h", "image_height"),
    "scale": (*DEPTH_SCALES, "scale"),
    "distortion": ("distortion", "distortion_coefficients", "dist_coeffs", "coeffs", "D"),
}


def read_camera_json(path: Path) -> Calibration:
    """Reads a camera from JSON. Raises RecordingError if there is none."""
    return camera_of(read_object(path), path)


def read_object(path: Path) -> dict[str, Any]:
    """Reads a JSON object. Raises RecordingError if there is none."""
    values = read_json(path, error=RecordingError, expected=EXPECTED)
    if not isinstance(values, dict):
        raise RecordingError(f"{path}: {type(values).__name__}, expected {EXPECTED}")
    return values


def camera_of(whole: Mapping[str, Any], path: Path) -> Calibration:
    """The camera that an object of a file states, or the sensor's times alone.

    A depth scale below 0.1 is taken as metres per unit, as RealSense's SDK gives it. Raises RecordingError if there is no camera.
    """
    values = _inner(whole)
    given = {key: values[name] for key, names in _NAMES.items() for name in reversed(names) if values.get(name) is not None}
    try:
        times = _times(values, path)
        matrix = next((values[name] for name in _MATRICES if isinstance(values.get(name), list)), None)
        if times != UNKNOWN and matrix is None and not given.keys() & {"fx", "fy", "cx", "cy"}:
            return Calibration(source=str(path)).with_times(times)  # another source states the camera
        if matrix is not None:
            camera = from_matrix(np.array(matrix, np.float64).reshape(3, 3), str(path))
        else:
            fx, fy, cx, cy = (float(given[key]) for key in ("fx", "fy", "cx", "cy"))
            camera = Calibration(fx, fy, cx, cy, source=str(path))
        width, height = (int(given[key]) if key in given else None for key in ("width", "height"))
        scale = float(given["scale"]) if "scale" in given else None
        distortion = [float(value) for value in given.get("distortion", ())]
        deformation = _deformation(values.get(DEFORMATION))
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise RecordingError(f"{path}: {fault(error)}, expected {EXPECTED}") from error
    camera = replace(camera, width=width, height=height, distortion=checked_distortion(distortion, str(path)))
    return replace(camera, depth_scale=units_per_metre(scale), deformation=deformation).with_times(times)


def _inner(whole: Mapping[str, Any]) -> Mapping[str, Any]:
    """The values of the camera, which may stand in an object of their own; the depth scale may stand beside that."""
    values = whole
    for key in _OBJECTS:
        if isinstance(values.get(key), dict):
            values = values[key]
    return values if values is whole else {name: whole[name] for name in _NAMES["scale"] if name in whole} | dict(values)


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
