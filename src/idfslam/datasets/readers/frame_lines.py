"""Apps on phones that write one line of JSON for each frame (.jsonl): camera, pose, stamp and files; depth also as raw float32 or uint16.

The names of values differ from app to app; those in use are listed below. Where a line names no files, its number, or its place, counts the
images of the colour and depth folders. Poses are ARKit's, with y up and z backward; matrices by columns are recognised.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.images.decoding import DEPTH_SUFFIXES, SUFFIXES, numbered
from idfslam.datasets.images.folders import colour_folder, depth_folder
from idfslam.datasets.near_miss import Likeness, Part, part
from idfslam.datasets.posed_images import FrameEntry, from_opengl, open_frames, stated_number
from idfslam.datasets.recording import Reader, Recording
from idfslam.errors import RecordingError
from idfslam.storage.json_file import parse_json
from idfslam.storage.plain_values import fault
from idfslam.storage.text_file import read_text

_EXPECTED = "an object with intrinsics, pose and timestamp of a frame"
_COLOUR = ("image", "rgb", "color", "colour", "image_path", "rgb_path", "color_path", "file_path", "image_file", "rgb_file", "color_file")
_DEPTH = ("depth", "depth_path", "depth_file", "depth_file_path", "depth_image")
_CAMERA = ("intrinsics", "camera_intrinsics", "cameraIntrinsics", "intrinsic_matrix", "intrinsicMatrix", "K")
_POSE = ("transform", "pose", "transform_matrix", "camera_pose", "cameraPose", "camera_transform", "cameraTransform", "T_wc")
_STAMP = ("timestamp", "time", "stamp", "t")
_NUMBER = ("frame", "index", "number", "frame_number", "frameNumber", "id")


def _file(path: Path) -> Path | None:
    files = [file for file in sorted(path.glob("*.jsonl")) if not file.name.startswith(".")]
    return files[0] if len(files) == 1 else None


def recognises(path: Path) -> bool:
    """A file of lines that state cameras, beside depth images: programs write .jsonl for other things too."""
    file = _file(path)
    if file is None or depth_folder(path) is None:
        return False
    head = read_text(file).split("\n", 1)[0]
    return any(f'"{name}"' in head for name in (*_CAMERA, "fx"))


def open_frame_lines(path: Path, stated: Calibration) -> Recording:
    """Opens the frames whose colour exists."""
    file = _file(path)
    if file is None:
        raise RecordingError(f"{path}: no single .jsonl file, expected one with a line of JSON for each frame")
    folders = (colour_folder(path), SUFFIXES), (depth_folder(path), DEPTH_SUFFIXES)
    colour, depth = (numbered(folder, suffixes=suffixes) if folder else {} for folder, suffixes in folders)
    lines = [(number, line) for number, line in enumerate(read_text(file).split("\n"), 1) if line.strip()]
    frames, poses = [], []
    for place, (number, line) in enumerate(lines):
        try:
            values = parse_json(line, source=f"{file}: line {number}", error=RecordingError, expected=_EXPECTED)
            counted = stated_number(values, *_NUMBER)
            counted = counted if counted == counted else float(place)
            images = _named(path, values, _COLOUR, colour.get(counted)), _named(path, values, _DEPTH, depth.get(counted))
            fx, fy, cx, cy = _intrinsics(values)
            width, height = (stated_number(values, *names) for names in (("width", "image_width", "w"), ("height", "image_height", "h")))
            poses.append(np.array(next((values[name] for name in _POSE if name in values), np.full(16, np.nan)), np.float64).reshape(4, 4))
            size = (int(width), int(height)) if min(width, height) > 0 else None
            frames.append((*images, (fx, fy, cx, cy), size, stated_number(values, *_STAMP)))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            raise RecordingError(f"{file}: line {number}: {fault(error)}, expected {_EXPECTED}") from error
    T_wc = [from_opengl(pose) for pose in _by_rows(np.array(poses).reshape(-1, 4, 4))]
    return open_frames(path, [FrameEntry(*frame[:4], T, frame[4]) for frame, T in zip(frames, T_wc)], stated, str(file))


def _named(path: Path, values: Mapping[str, Any], names: tuple[str, ...], numbered_file: Path | None) -> Path:
    """The file that a line names, else the one of its number."""
    name = next((values[name] for name in names if isinstance(values.get(name), str)), None)
    return path / name.replace("\\", "/") if name else numbered_file or path / f"{names[0]} of this line"


def _intrinsics(values: Mapping[str, Any]) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy [px] from an object, four numbers, or a matrix by rows or columns."""
    stated = next((values[name] for name in _CAMERA if name in values), values)
    if isinstance(stated, dict):
        fx, fy, cx, cy = (stated_number(stated, *names) for names in (("fx", "fl_x"), ("fy", "fl_y"), ("cx", "ppx"), ("cy", "ppy")))
        return fx, fy, cx, cy
    numbers = np.array(stated, np.float64).ravel()
    if len(numbers) == 9:
        K = numbers.reshape(3, 3)
        numbers = (K if K[2, 0] == 0 else K.T)[[0, 1, 0, 1], [0, 1, 2, 2]]
    fx, fy, cx, cy = numbers.tolist()
    return fx, fy, cx, cy


def _by_rows(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 4, 4) with the translations in the last column, where by columns they stand in the last row."""
    by_columns = np.nanmax(np.abs(matrices[:, 3, :3]), initial=0) > 0 and np.nanmax(np.abs(matrices[:, :3, 3]), initial=0) == 0
    return matrices.swapaxes(1, 2) if by_columns else matrices


READER = Reader(
    "frame_lines",
    "a .jsonl file with a line for each frame, colour and depth images",
    recognises,
    open_frame_lines,
    likeness=Likeness(
        "a phone's recording with a line for each frame", (part("*.jsonl", "a .jsonl file"), Part("depth images", recognises))
    ),
)
