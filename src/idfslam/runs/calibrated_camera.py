"""The camera file of a calibrated recording: its values for the images as they are stored."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.self_calibration import CameraEstimate, confirmed
from idfslam.adjustment.sensor_times import SensorTime
from idfslam.datasets import Dataset
from idfslam.datasets.cameras.camera_json import DEFORMATION
from idfslam.datasets.provenance import Provenance, is_guessed, provenance
from idfslam.errors import ConfigError
from idfslam.geometry.camera import Camera
from idfslam.runs import result_folder
from idfslam.sensing.depth_deformation import DepthDeformation
from idfslam.storage import atomic_files

_GRID = 12  # points a side at which the distortion of two lenses in a row is fitted; more: slower, and no more exact


def check_camera_path(path: Path) -> None:
    """Raises ConfigError for a path at which no camera file can be written, or from which none would be read as JSON."""
    if path.suffix != ".json":
        raise ConfigError(f"--out {path}: expected the name of a file that ends with .json, such as camera.json")
    parent = next(folder for folder in (path.parent, *path.parent.parents) if folder.exists())
    if path.is_dir():
        raise ConfigError(f"--out {path}: is a folder, expected the name of a file")
    if not parent.is_dir():
        raise ConfigError(f"--out {path}: {parent} is a file, expected a folder: choose another name")


def write_camera(path: Path, estimate: CameraEstimate, recording: Dataset, times: Mapping[str, SensorTime] = MappingProxyType({})) -> None:
    """Writes the camera file of a recording that was read as `recording` and calibrated. Stated values that fit stay, guesses do not.

    times: of the sensor, by name; those that differ from zero for sure are written.
    """
    model = estimate.model if is_guessed(recording) else confirmed(estimate)
    values = camera_values(model, recording.camera, provenance(recording) or Provenance(""))
    values |= {name: round(time.value, 5) for name, time in times.items() if time.is_sure and (time.value > 0 or name == "depth_delay")}
    with result_folder.writing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_files.write_json(path, {"camera": values})


def camera_values(model: CameraModel, read_as: Camera, stated: Provenance) -> dict[str, Any]:
    """`camera` of cam_params.json for the images as they are stored, which are read as `read_as` with what is `stated` taken out."""
    camera, lens = combined_lens(stated.distortion, read_as, model)
    size = stated.size or (camera.width, camera.height)
    c = camera.resized(*size)
    values: dict[str, Any] = {"w": c.width, "h": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy}
    values["scale"] = stated.depth_scale / model.depth_factor
    both = zip(*(vars(each).values() for each in (stated.deformation or DepthDeformation(), model.deformation)))
    deformation = DepthDeformation(*(a + b for a, b in both))
    return values | ({"distortion": list(lens)} if any(lens) else {}) | ({DEFORMATION: vars(deformation)} if deformation else {})


def combined_lens(distortion: Sequence[float], read_as: Camera, model: CameraModel) -> tuple[Camera, tuple[float, ...]]:
    """The camera and lens (OpenCV's k1 k2 p1 p2 k3 ...) of images that were undistorted to `read_as` and then found to be of `model`."""
    if not any(distortion):
        return model.camera, ((*model.distortion, 0.0, 0.0) if any(model.distortion) else ())
    import cv2

    x, y = np.meshgrid(*(np.linspace(-0.5, n - 0.5, _GRID) for n in (read_as.width, read_as.height)))
    rays = model.rays(np.stack([x.ravel(), y.ravel()], 1))
    uv = model.project(rays)[0]
    before = np.concatenate([(uv - [read_as.cx, read_as.cy]) / [read_as.fx, read_as.fy], np.ones((len(uv), 1))], 1)
    origin = np.zeros(3)
    raw = cv2.projectPoints(before, origin, origin, read_as.matrix().numpy(), np.array(distortion))[0][:, 0]

    def off(p: NDArray[np.float64]) -> NDArray[np.float64]:
        K = np.array([[p[0], 0, p[2]], [0, p[1], p[3]], [0, 0, 1]])
        return np.asarray(cv2.projectPoints(rays, origin, origin, K, p[4:])[0][:, 0] - raw, np.float64).ravel()

    c, lens = model.camera, [*distortion, *[0.0] * (5 - len(distortion))]
    fit = least_squares(off, [c.fx, c.fy, c.cx, c.cy, *lens], x_scale=[c.fx, c.fx, c.fx, c.fx, *[0.1] * len(lens)]).x.tolist()
    return Camera(c.width, c.height, *fit[:4]), tuple(fit[4:])
