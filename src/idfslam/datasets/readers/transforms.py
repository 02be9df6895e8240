"""transforms.json with depth: nerfstudio, instant-ngp, NeRFCapture, Polycam by way of nerfstudio, and `idf-slam export --to nerfstudio`.

Cameras look along -z with y up, and pixel centres lie at half integers; both are converted. Depth images are named by `depth_file_path` or
`depth_path`. Integers are millimetres unless `integer_depth_scale` or `depth_unit_scale_factor` says how many metres a unit is.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.images.file_list import listed_image
from idfslam.datasets.near_miss import Likeness, Part, part
from idfslam.datasets.posed_images import FrameEntry, from_opengl, open_frames, stated_number
from idfslam.datasets.recording import Reader, Recording
from idfslam.errors import RecordingError
from idfslam.storage.json_file import read_json
from idfslam.storage.plain_values import fault
from idfslam.storage.text_file import read_text

TRANSFORMS = "transforms.json"
_EXPECTED = "frames with file_path, depth_file_path and transform_matrix, and fl_x, fl_y, cx, cy"
_DEPTH = ("depth_file_path", "depth_path")
_UNITS = ("integer_depth_scale", "depth_unit_scale_factor")  # [m] of one unit
_SUFFIXES = (".png", ".jpg", ".jpeg")  # of images that are named without


def recognises(path: Path) -> bool:
    """Recognised if it names depth images: a transforms.json may also lie beside the folders of another layout."""
    return (path / TRANSFORMS).is_file() and any(f'"{name}"' in read_text(path / TRANSFORMS) for name in _DEPTH)


def open_transforms(path: Path, stated: Calibration) -> Recording:
    """Opens all frames; one that names no depth image has none of its own."""
    file = path / TRANSFORMS
    if not file.is_file():
        raise RecordingError(f"{path}: {TRANSFORMS} is missing, expected the file that nerfstudio and NeRFCapture write")
    try:
        values = read_json(file, error=RecordingError, expected=_EXPECTED)
        frames = [_frame(path, {**values, **frame}) for frame in values["frames"]]
        unit, distortion = stated_number(values, *_UNITS), tuple(stated_number(values, name) for name in ("k1", "k2", "p1", "p2", "k3"))
        model = str(values.get("camera_model", ""))
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise RecordingError(f"{file}: {fault(error)}, expected {_EXPECTED}") from error
    lens = tuple(0.0 if value != value else value for value in distortion)
    if "FISHEYE" in model.upper() and any(lens):
        raise RecordingError(f"{file}: camera_model {model}, expected OPENCV or PINHOLE: undistort the images")
    scale = 1 / unit if unit > 0 else None
    return open_frames(path, frames, stated, str(file), depth_scale=scale, distortion=lens if any(lens) else None)


def _frame(path: Path, values: Mapping[str, Any]) -> FrameEntry:
    """A frame's own values over those of the file."""
    fx = stated_number(values, "fl_x", "fx")
    size = tuple(stated_number(values, name) for name in ("w", "h"))
    cx, cy = (stated_number(values, name) - 0.5 for name in ("cx", "cy"))
    depth = next((str(values[name]) for name in _DEPTH if name in values), None)
    return FrameEntry(
        _image(path, str(values["file_path"])),
        None if depth is None else _image(path, depth),
        (fx, fy if (fy := stated_number(values, "fl_y", "fy")) == fy else fx, cx, cy),
        (int(size[0]), int(size[1])) if min(size) > 0 else None,
        from_opengl(values.get("transform_matrix")),
        stated_number(values, "timestamp"),
    )


def _image(path: Path, name: str) -> Path:
    """The file of an image, whose name may lack the suffix."""
    for suffix in ("", *_SUFFIXES):
        file, problem = listed_image(path, name + suffix)
        if not problem:
            return file
    return path / name


READER = Reader(
    "transforms",
    "transforms.json with depth_file_path or depth_path",
    recognises,
    open_transforms,
    likeness=Likeness("a folder of nerfstudio", (part(TRANSFORMS), Part("depth images (depth_file_path in it)", recognises))),
)
