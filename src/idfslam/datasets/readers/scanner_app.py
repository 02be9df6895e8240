"""3D Scanner App (iPhone, iPad), "all data": frame_NNNNN.jpg, depth_NNNNN.png [mm], conf_NNNNN.png and frame_NNNNN.json.

Colour is larger than depth; both become at most 640 pixels a side (see `resampling`). ARKit's poses, with y up and z backward, are the
ground truth. Only some frames have a colour image: those are read.
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

_EXPECTED = "intrinsics of 9 numbers and cameraPoseARFrame of 16"


def recognises(path: Path) -> bool:
    return all(any(path.glob(pattern)) for pattern in ("frame_*.jpg", "frame_*.json", "depth_*.png"))


def open_scanner_app(path: Path, stated: Calibration) -> Recording:
    """Opens the frames that have image and JSON of one number."""
    images, depth, confidence = (numbered(path, pattern) for pattern in ("frame_*", "depth_*", "conf_*"))
    states = numbered(path, "frame_*", suffixes=frozenset({".json"}))
    frames = [_frame(images[number], depth.get(number), states[number], confidence.get(number)) for number in images if number in states]
    return open_frames(path, frames, stated, f"{path}: frame_*.json")


def _frame(colour: Path, depth: Path | None, state: Path, confidence: Path | None) -> FrameEntry:
    try:
        values = read_json(state, error=RecordingError, expected=_EXPECTED)
        K = np.array(values["intrinsics"], np.float64).reshape(3, 3)
        T = np.array(values.get("cameraPoseARFrame", np.full(16, np.nan)), np.float64).reshape(4, 4)
        stamp = stated_number(values, "time")
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise RecordingError(f"{state}: {fault(error)}, expected {_EXPECTED}") from error
    intrinsics = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    return FrameEntry(colour, depth, intrinsics, None, from_opengl(T), stamp, confidence)


READER = Reader(
    "scanner_app",
    "frame_NNNNN.jpg, frame_NNNNN.json, depth_NNNNN.png of 3D Scanner App",
    recognises,
    open_scanner_app,
    likeness=Likeness("an export of 3D Scanner App", (part("frame_*.jpg"), part("frame_*.json"), part("depth_*.png"))),
)
