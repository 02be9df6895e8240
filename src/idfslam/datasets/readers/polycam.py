"""Polycam's raw data (iPhone, iPad): keyframes/ with images/, depth/ [mm], confidence/ and cameras/.

Colour is larger than depth; both become at most 640 pixels a side (see `resampling`). corrected_images/ and corrected_cameras/ are
preferred: Polycam's after its own optimisation, without distortion. Poses t_00 to t_23 have y up and z backward, and are the ground truth.
"""

from pathlib import Path

import numpy as np

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.images.decoding import numbered
from idfslam.datasets.near_miss import Likeness, part
from idfslam.datasets.posed_images import FrameEntry, from_opengl, open_frames, stated_number
from idfslam.datasets.recording import Reader, Recording
from idfslam.errors import RecordingError
from idfslam.storage.json_file import read_json
from idfslam.storage.plain_values import fault

_KINDS = ("corrected_", "")
_EXPECTED = "fx, fy, cx, cy and t_00 to t_23"


def _keyframes(path: Path) -> Path:
    return path / "keyframes" if (path / "keyframes").is_dir() else path


def _kind(folder: Path) -> str | None:
    """The prefix of the folders of images and cameras; None if there are none."""
    return next((kind for kind in _KINDS if all((folder / f"{kind}{name}").is_dir() for name in ("images", "cameras"))), None)


def recognises(path: Path) -> bool:
    folder = _keyframes(path)
    return _kind(folder) is not None and (folder / "depth").is_dir()


def open_polycam(path: Path, stated: Calibration) -> Recording:
    """Opens the frames that have image and camera of one name."""
    folder = _keyframes(path)
    kind = _kind(folder)
    if kind is None:
        raise RecordingError(f"{path}: expected keyframes/ with images/, depth/ and cameras/: export Polycam's raw data")
    images, depth, confidence = (numbered(folder / name) for name in (f"{kind}images", "depth", "confidence"))
    cameras = numbered(folder / f"{kind}cameras", suffixes=frozenset({".json"}))
    frames = [
        _frame(colour, depth.get(number), cameras[number], confidence.get(number)) for number, colour in images.items() if number in cameras
    ]
    return open_frames(path, frames, stated, str(folder / f"{kind}cameras"))


def _frame(colour: Path, depth: Path | None, camera: Path, confidence: Path | None) -> FrameEntry:
    try:
        values = read_json(camera, error=RecordingError, expected=_EXPECTED)
        rows = [[stated_number(values, f"t_{i}{k}") for k in range(4)] for i in range(3)]
        fx, fy, cx, cy, width, height = (stated_number(values, name) for name in ("fx", "fy", "cx", "cy", "width", "height"))
        stamp = stated_number(values, "timestamp")
        size = (int(width), int(height)) if min(width, height) > 0 else None
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        raise RecordingError(f"{camera}: {fault(error)}, expected {_EXPECTED}") from error
    return FrameEntry(colour, depth, (fx, fy, cx, cy), size, from_opengl(np.array(rows)), stamp, confidence)


READER = Reader(
    "polycam",
    "keyframes/ with images/, depth/, cameras/ of Polycam",
    recognises,
    open_polycam,
    likeness=Likeness(
        "Polycam's raw data", (part("keyframes/*images", "keyframes/images/"), part("keyframes/depth"), part("keyframes/*cameras"))
    ),
)
