"""TUM RGB-D: rgb.txt, depth.txt and groundtruth.txt list stamped files; depth in 1/5000 m (Sturm et al., IROS 2012)."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets import poses
from idfslam.datasets.calibration import Calibration, assumed_scale
from idfslam.datasets.camera_files import read_beside, read_depth_camera
from idfslam.datasets.images import ImageFiles
from idfslam.datasets.recording import Reader, Recording
from idfslam.datasets.recording_path import names
from idfslam.errors import RecordingError
from idfslam.geometry.association import TOLERANCE, associate

# The published calibrations of the three cameras, by the N in "freiburgN". Depth is registered to colour
FREIBURG = {
    "1": Calibration(517.3, 516.5, 318.6, 255.3, 640, 480, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "2": Calibration(520.9, 521.0, 325.1, 249.7, 640, 480, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "3": Calibration(535.4, 539.2, 320.1, 247.6, 640, 480),
}


def recognises(path: Path) -> bool:
    return (path / "rgb.txt").is_file() and (path / "depth.txt").is_file()


def open_tum(path: Path, override: Calibration) -> Recording:
    """Opens a sequence. A frame's stamp is that of its colour image; its true pose is the nearest in time within 20 ms."""
    for name in ("rgb.txt", "depth.txt"):
        if not (path / name).is_file():
            raise RecordingError(f"{path}: {name} is missing, expected rgb.txt and depth.txt")
    colour, depth = read_list(path / "rgb.txt"), read_list(path / "depth.txt")
    timestamps = np.array([stamp for stamp, _ in colour])
    pairs = associate(timestamps, [stamp for stamp, _ in depth])
    if not len(pairs):
        raise RecordingError(f"{path}: no colour and depth image within {1000 * TOLERANCE:.0f} ms, expected stamps of one clock")
    timestamps = timestamps[pairs[:, 0]]
    return Recording(
        path.name,
        ImageFiles([(colour[i][1], depth[k][1]) for i, k in pairs]),
        timestamps=timestamps,
        ground_truth=read_ground_truth(path / "groundtruth.txt", timestamps),
        calibration=override.over(read_beside(path)).over(published(path)).over(assumed_scale(5000, "TUM layout")),
        depth_camera=read_depth_camera(path),
    )


def published(path: Path) -> Calibration:
    """The published camera that the folder's name tells; empty for other names. A name that only contains `freiburg1` is a guess."""
    for name in names(path):
        if match := re.search(r"(?P<published>^rgbd_dataset_)?freiburg(?P<camera>[123])", name):
            guess = "" if match["published"] else f", guessed from the folder's name {name}"
            return replace(FREIBURG[match["camera"]], source=f"the published camera of TUM freiburg{match['camera']}{guess}")
    return Calibration()


def read_list(path: Path) -> list[tuple[float, Path]]:
    """(stamp [s], image) of every line `stamp file`, sorted by stamp; `#` starts a comment."""
    entries = []
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        try:
            stamp = float(words[0])
        except ValueError:
            stamp = np.nan
        if len(words) < 2 or not np.isfinite(stamp):
            raise RecordingError(f"{path}: line {number} is '{line.strip()}', expected a stamp in seconds and a file")
        entries.append((stamp, path.parent / words[1]))
    if not entries:
        raise RecordingError(f"{path}: empty, expected lines of a stamp in seconds and a file")
    return sorted(entries)


def read_ground_truth(path: Path, timestamps: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """(N, 4, 4), NaN where no pose lies within 20 ms; None without the file."""
    if not path.is_file():
        return None
    stamps, reference = poses.read_freiburg(path)
    if not len(stamps):
        raise RecordingError(f"{path}: empty, expected lines of stamp tx ty tz qx qy qz qw: fill or remove it")
    T_wc = poses.at_stamps(stamps, reference, timestamps, TOLERANCE)
    if not np.isfinite(T_wc).all((1, 2)).any():
        span = f"poses from {stamps[0]:.3f} to {stamps[-1]:.3f} s, images from {timestamps[0]:.3f} to {timestamps[-1]:.3f} s"
        raise RecordingError(f"{path}: {span}: no finite pose within {1000 * TOLERANCE:.0f} ms of an image: correct or remove the file")
    return poses.checked(T_wc, count=len(timestamps), source=lambda _: str(path))


READER = Reader("tum", "rgb.txt, depth.txt", recognises, open_tum)
