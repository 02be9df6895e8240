"""The camera of a recording: values from the user, from files and from publications, and their order of precedence."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.poses import RIGID
from idfslam.errors import ConfigError, RecordingError
from idfslam.geometry.camera import Camera
from idfslam.geometry.rigid_transform import is_rigid

GIVE_CAMERA = "give cam_params.json in the recording or --camera.fx --camera.fy --camera.cx --camera.cy"
_FORM = '{"camera": {"w", "h", "fx", "fy", "cx", "cy", "scale"}} with numbers'
CAMERA_FILES = ("intrinsics.txt", "camera-intrinsics.txt", "calibration.txt", "calib.txt", "camera.txt")


@dataclass(frozen=True)
class Calibration:
    """Values of a camera from one source (the user, a file, a publication); None where the source gives no value."""

    fx: float | None = None  # [px], like fy, cx, cy
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None
    width: int | None = None  # [px] of the images that it is valid for
    height: int | None = None
    distortion: tuple[float, ...] | None = None  # OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]]
    depth_scale: float | None = None  # units of the depth images per metre
    source: str = "the command line"
    assumed: str = ""  # where a depth scale comes from that nobody stated, for example "TUM layout"

    @property
    def complete(self) -> bool:
        """Whether focal lengths and principal point are all given."""
        return None not in (self.fx, self.fy, self.cx, self.cy)

    def over(self, other: "Calibration") -> "Calibration":
        """These values, with missing ones taken from `other`, a source of lower precedence.

        If fx, fy, cx and cy are all given, only the depth scale is taken from `other`: without distortion values there is no distortion.
        """
        scale, assumed = (other.depth_scale, other.assumed) if self.depth_scale is None else (self.depth_scale, self.assumed)
        if self.complete:
            return replace(self, depth_scale=scale, assumed=assumed)
        stated = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("source", "assumed")}
        stated = {name: value for name, value in stated.items() if value is not None}
        if partly := [name for name in ("fx", "fy", "cx", "cy") if name in stated]:
            stated["source"] = f"{other.source} with {', '.join(partly)} of {self.source}" if other.complete else self.source
        return replace(other, **(stated | {"depth_scale": scale, "assumed": assumed}))

    def resized(self, size: tuple[int, int], to: tuple[int, int]) -> "Calibration":
        """The calibration after images of one size (width, height) [px] were scaled to another; unchanged if it is not complete."""
        if self.fx is None or self.fy is None or self.cx is None or self.cy is None:
            return self
        camera = Camera(*size, self.fx, self.fy, self.cx, self.cy).resized(*to)
        return replace(self, fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy, width=to[0], height=to[1])

    def camera(self, width: int, height: int, recording: str) -> Camera:
        """The camera of images `width` x `height` [px].

        Raises RecordingError if the camera is unknown, valid for another image size only, or impossible.
        """
        if self.fx is None or self.fy is None or self.cx is None or self.cy is None:
            missing = ", ".join(name for name in ("fx", "fy", "cx", "cy") if getattr(self, name) is None)
            raise RecordingError(f"{recording}: the camera is unknown ({missing} missing): {GIVE_CAMERA}")
        size = (self.width or width, self.height or height)
        if size != (width, height):
            expected = f"the camera of {self.source} is for {size[0]}x{size[1]}"
            raise RecordingError(f"{recording}: images are {width}x{height}, but {expected}: {GIVE_CAMERA} of these images")
        if not all(map(math.isfinite, (self.fx, self.fy, self.cx, self.cy))) or min(self.fx, self.fy) <= 0:
            found = f"fx {self.fx}, fy {self.fy}, cx {self.cx}, cy {self.cy}"
            raise RecordingError(f"{recording}: {self.source} says {found}: expected finite numbers with fx and fy above 0 (y points down)")
        if not (0 <= self.cx < width and 0 <= self.cy < height):
            found = f"the principal point ({self.cx}, {self.cy}) of {self.source} lies outside the {width}x{height} images"
            raise RecordingError(f"{recording}: {found}: {GIVE_CAMERA} in pixels of these images")
        return Camera(width, height, float(self.fx), float(self.fy), float(self.cx), float(self.cy))

    def scale(self, recording: str) -> float:
        """Units of the depth images per metre; raises RecordingError if unknown or not positive."""
        if self.depth_scale is None or not (math.isfinite(self.depth_scale) and self.depth_scale > 0):
            found = f"the depth scale is {self.depth_scale}"
            raise RecordingError(f"{recording}: {found}, expected units per metre above 0: give --camera.depth-scale")
        return self.depth_scale


def assumed_scale(depth_scale: float, why: str = "assumed") -> Calibration:
    """The depth scale [units per metre] of a layout, for recordings that state none; `why` says so in the line about the recording."""
    return Calibration(depth_scale=depth_scale, assumed=why)


def override(camera: Mapping[str, float | None] | None, depth_scale: float | None = None) -> Calibration:
    """The user's values: any of fx, fy, cx, cy, depth_scale; None counts as not given. Raises ConfigError for other keys."""
    values = {key: value for key, value in (camera or {}).items() if value is not None}
    allowed = ("fx", "fy", "cx", "cy", "depth_scale")
    if unknown := [key for key in values if key not in allowed]:
        raise ConfigError(f"camera: unknown value '{unknown[0]}', expected any of {', '.join(allowed)}")
    scale = values.get("depth_scale") if depth_scale is None else depth_scale
    return Calibration(values.get("fx"), values.get("fy"), values.get("cx"), values.get("cy"), depth_scale=scale)


@dataclass(frozen=True)
class DepthCameraCalibration:
    """The calibration of a depth camera whose images are not registered to the colour camera."""

    calibration: Calibration
    T_colour_depth: NDArray[np.float64]  # (4, 4) [m] depth camera to colour camera


def read_cam_params(*folders: Path) -> Calibration:
    """Reads cam_params.json, {"camera": {w, h, fx, fy, cx, cy, scale[, distortion]}}, from the first folder that has one."""
    path = _cam_params(folders)
    return Calibration() if path is None else _camera_of(_json(path), "camera", path)


def read_depth_camera(*folders: Path) -> DepthCameraCalibration | None:
    """Reads the depth camera from cam_params.json, {"depth_camera": like "camera", "T_colour_depth": 4x4}; None: depth is registered."""
    path = _cam_params(folders)
    if path is None or "depth_camera" not in (values := _json(path)):
        return None
    try:
        T = np.array(values["T_colour_depth"], np.float64)
        rigid = T.shape == (4, 4) and bool(np.isfinite(T).all()) and bool(is_rigid(T[None], tolerance=RIGID)[0])
    except (KeyError, ValueError, TypeError):
        rigid = False
    if not rigid:
        raise RecordingError(f'{path}: expected "T_colour_depth" beside "depth_camera": a rigid 4x4 matrix, depth to colour camera, metres')
    return DepthCameraCalibration(_camera_of(values, "depth_camera", path), T)


def _cam_params(folders: tuple[Path, ...]) -> Path | None:
    return next((folder / "cam_params.json" for folder in folders if (folder / "cam_params.json").is_file()), None)


def _json(path: Path) -> dict[str, Any]:
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise RecordingError(f"{path}: {type(error).__name__} {error}, expected {_FORM}") from error
    if not isinstance(values, dict):
        raise RecordingError(f"{path}: {type(values).__name__}, expected {_FORM}")
    return values


def _camera_of(values: dict[str, Any], key: str, path: Path) -> Calibration:
    try:
        values = values[key]
        fx, fy, cx, cy = (float(values[key]) for key in ("fx", "fy", "cx", "cy"))
        width, height = (int(values[key]) if key in values else None for key in ("w", "h"))
        scale = float(values["scale"]) if "scale" in values else None
        distortion = tuple(float(value) for value in values.get("distortion", ())) or None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordingError(f"{path}: {type(error).__name__} {error}, expected {_FORM}") from error
    if distortion is not None and len(distortion) not in (4, 5, 8):
        raise RecordingError(f"{path}: {len(distortion)} distortion values, expected k1 k2 p1 p2 [k3 [k4 k5 k6]]")
    return Calibration(fx, fy, cx, cy, width, height, distortion, scale, source=str(path))


def read_camera_file(folder: Path, names: tuple[str, ...] = CAMERA_FILES) -> Calibration:
    """Reads the first of the text files that exists: a 3x3 or 4x4 matrix K, or one line `fx fy cx cy [k1 k2 p1 p2 [k3]]`.

    `#` starts a comment.
    """
    path = next((folder / name for name in names if (folder / name).is_file()), None)
    if path is None:
        return Calibration()
    lines = [line.split("#")[0].replace(",", " ").split() for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    try:
        rows = [[float(number) for number in line] for line in lines if line]
    except ValueError as error:
        raise RecordingError(f"{path}: {error}, expected a 3x3 matrix or one line of fx fy cx cy [k1 k2 p1 p2 [k3]]") from error
    if len(rows) == 1 and len(rows[0]) in (4, 8, 9):
        fx, fy, cx, cy, *distortion = rows[0]
        return Calibration(fx, fy, cx, cy, distortion=tuple(distortion) or None, source=str(path))
    if [len(row) for row in rows] not in ([3] * 3, [4] * 3, [4] * 4):
        found = f"{len(rows)} rows of {sorted({len(row) for row in rows})} numbers"
        raise RecordingError(f"{path}: {found}, expected a 3x3 matrix or one line of fx fy cx cy [k1 k2 p1 p2 [k3]]")
    K = np.array(rows)
    if not np.array_equal(K[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]], [0, 0, 0, 0, 1]):
        raise RecordingError(f"{path}: not a pinhole matrix, expected rows fx 0 cx, 0 fy cy, 0 0 1")
    fx, fy, cx, cy = (float(value) for value in K[[0, 1, 0, 1], [0, 1, 2, 2]])
    return Calibration(fx, fy, cx, cy, source=str(path))
