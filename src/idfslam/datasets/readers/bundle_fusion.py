"""BundleFusion: frame-NNNNNN.color.jpg, frame-NNNNNN.depth.png, frame-NNNNNN.pose.txt, and info.txt with camera and depth scale."""

import re
from pathlib import Path

import numpy as np

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.cameras.camera_text import from_matrix
from idfslam.datasets.images.decoding import ImageFiles, numbered
from idfslam.datasets.images.depth_units import usual_scale
from idfslam.datasets.images.pairs import paired
from idfslam.datasets.near_miss import Likeness, part
from idfslam.datasets.provenance import ASSUMED
from idfslam.datasets.readers.folder import read_pose_files
from idfslam.datasets.recording import FPS, Reader, Recording
from idfslam.errors import RecordingError
from idfslam.storage.plain_values import fault
from idfslam.storage.text_file import read_text

INFO = "info.txt"


def recognises(path: Path) -> bool:
    return (path / INFO).is_file() and any(path.glob("frame-*.color.*")) and any(path.glob("frame-*.depth.*"))


def open_bundle_fusion(path: Path, stated: Calibration) -> Recording:
    """Opens a folder. A pose of inf means that the frame was not registered."""
    pairs = paired(numbered(path, "frame-*.color.*"), numbered(path, "frame-*.depth.*"), path)
    camera = read_info(path / INFO) if (path / INFO).is_file() else Calibration()
    return Recording(
        path.name,
        ImageFiles(pairs.files),
        timestamps=pairs.places / FPS,
        depth_timestamps=pairs.depth_timestamps(pairs.places / FPS),
        stamps_source=ASSUMED,
        ground_truth=lambda: read_pose_files(path, "frame-*.pose.txt", pairs),
        calibration=stated.over(camera).over(usual_scale(pairs.files)),
    )


def read_info(path: Path) -> Calibration:
    """Camera and depth scale of lines `name = values`; raises RecordingError if the camera is malformed."""
    values = {match[1].lower(): match[2].split() for match in re.finditer(r"^\s*m_(\w+)\s*=\s*(.*)$", read_text(path), re.MULTILINE)}
    try:
        K = np.array(values["calibrationcolorintrinsic"], np.float64).reshape(4, 4)
        width, height = (int(values[f"color{name}"][0]) for name in ("width", "height"))
        scale = float(values["depthshift"][0]) if "depthshift" in values else None
    except (ValueError, KeyError, IndexError, OverflowError) as error:
        expected = "expected m_colorWidth, m_colorHeight and m_calibrationColorIntrinsic of 16 numbers"
        raise RecordingError(f"{path}: {fault(error)}, {expected}") from error
    camera = from_matrix(K[:3, :3], str(path))
    return Calibration(camera.fx, camera.fy, camera.cx, camera.cy, width, height, depth_scale=scale, source=str(path))


READER = Reader(
    "bundle_fusion",
    "frame-NNNNNN.color.jpg, frame-NNNNNN.depth.png, info.txt",
    recognises,
    open_bundle_fusion,
    likeness=Likeness("a sequence of BundleFusion", (part("frame-*.color.jpg"), part("frame-*.depth.png"), part(INFO))),
)
