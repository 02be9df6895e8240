"""TUM RGB-D: rgb.txt, depth.txt and groundtruth.txt list stamped files; depth in 1/5000 m (Sturm et al., IROS 2012).

Instead of rgb.txt and depth.txt there may be associations.txt, as the benchmark's associate.py writes it: stamp and file of a colour and
of a depth image in each line.
"""

import logging
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.cameras.camera_files import read_depth_camera
from idfslam.datasets.images.decoding import FilePair, ImageFiles
from idfslam.datasets.images.depth_units import usual_scale
from idfslam.datasets.images.file_list import listed_image, listed_lines, number
from idfslam.datasets.images.pairs import warn_left_out
from idfslam.datasets.images.partners import stamps_of, warn_without_own, with_nearest
from idfslam.datasets.near_miss import Likeness, part
from idfslam.datasets.poses.truth import Truth, read_stamped
from idfslam.datasets.recording import Reader, Recording
from idfslam.datasets.recording_path import names
from idfslam.datasets.time_stamps import in_seconds, units_per_second
from idfslam.errors import RecordingError
from idfslam.geometry.association import TOLERANCE, associate

log = logging.getLogger(__name__)

# The published calibrations of the three cameras, by the N in "freiburgN". Depth is registered to colour. The read-out times of the first
# are those that fit the motion capture of freiburg1_rpy best (benchmarks/true_times.py: 26.0 ms of colour, 36.0 of depth); of the others
# nothing is known. The delay of depth is that of a recording's stamps, and is estimated.
FREIBURG = {
    "1": Calibration(517.3, 516.5, 318.6, 255.3, 640, 480, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633), readout=0.026, depth_readout=0.036),
    "2": Calibration(520.9, 521.0, 325.1, 249.7, 640, 480, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "3": Calibration(535.4, 539.2, 320.1, 247.6, 640, 480),
}
BONN = Calibration(542.822841, 542.57687, 315.59352, 237.756098, 640, 480, (0.039903, -0.099343, -0.00073, -0.000144, 0.0))
"""The published calibration of the Bonn RGB-D Dynamic sequences, which have the same layout (Palazzolo et al., IROS 2019)."""
_LISTS = ("rgb.txt", "depth.txt")
_ASSOCIATIONS = ("associations.txt", "association.txt", "associated.txt", "associate.txt")


def recognises(path: Path) -> bool:
    """One list beside the folders of images suffices, to be told which list is missing: as a plain folder they would have another scale."""
    one_list = any((path / name).is_file() for name in _LISTS) and (path / "rgb").is_dir() and (path / "depth").is_dir()
    return _has_lists(path) or _associations(path) is not None or one_list


def _has_lists(path: Path) -> bool:
    return all((path / name).is_file() for name in _LISTS)


def _associations(path: Path) -> Path | None:
    return next((path / name for name in _ASSOCIATIONS if (path / name).is_file()), None)


def open_tum(path: Path, stated: Calibration) -> Recording:
    """Opens a sequence. Every colour image is a frame, and the true pose is the nearest to its stamp within 20 ms."""
    stamps, files = _paired_by_stamp(path) if _has_lists(path) else _associated(path)
    timestamps = stamps[:, 0]
    return Recording(
        path.name,
        ImageFiles(files),
        timestamps=timestamps,
        depth_timestamps=stamps[:, 1],
        ground_truth=lambda: read_ground_truth(path / "groundtruth.txt", timestamps),
        calibration=stated.over(published(path)).over(usual_scale(files, 5000, "TUM layout")),
        depth_camera=read_depth_camera(path),
    )


def published(path: Path) -> Calibration:
    """The published camera that the folder's name tells; empty for other names. A name that only contains `freiburg1` is a guess."""
    for name in names(path):
        if match := re.search(r"(?P<published>^rgbd_dataset_)?freiburg(?P<camera>[123])", name):
            guess = "" if match["published"] else f", guessed from the folder's name {name}"
            return replace(FREIBURG[match["camera"]], source=f"the published camera of TUM freiburg{match['camera']}{guess}")
        if name.startswith("rgbd_bonn_"):
            return replace(BONN, source="the published camera of the Bonn RGB-D Dynamic sequences")
    return Calibration()


def _paired_by_stamp(path: Path) -> tuple[NDArray[np.float64], list[FilePair]]:
    """Stamps (N, 2) [s] of colour and depth images, NaN without depth, and the images, of rgb.txt and depth.txt."""
    (t_colour, colour), (t_depth, depth) = (read_list(path / name) for name in _LISTS)
    first, second = t_colour[:, 0], t_depth[:, 0]
    if units_per_second(first) == units_per_second(second):
        stamps = in_seconds(np.concatenate([first, second]), str(path))
        first, second = stamps[: len(first)], stamps[len(first) :]
    else:
        first, second = (in_seconds(stamps, str(path / name)) for stamps, name in zip((first, second), _LISTS))
    pairs = associate(first, second)
    if not len(pairs):
        raise RecordingError(f"{path}: no colour and depth image within {1000 * TOLERANCE:.0f} ms, expected stamps of one clock")
    partner = with_nearest(pairs, first, second)
    warn_without_own(str(path), len(pairs), len(partner))
    files = [(image, depth[k][0] if k >= 0 else None) for (image,), k in zip(colour, partner.tolist())]
    return np.stack([first, stamps_of(second, partner)], 1), files


def _associated(path: Path) -> tuple[NDArray[np.float64], list[FilePair]]:
    """The same of associations.txt, whose images may come in either order."""
    file = _associations(path)
    if file is None:
        missing = next(name for name in _LISTS if not (path / name).is_file())
        raise RecordingError(f"{path}: {missing} is missing, expected rgb.txt and depth.txt, or associations.txt, or --format folder")
    stamps, files = read_list(file, images=2)
    colour = 1 if "depth" in files[0][0].parent.name.lower() else 0
    return in_seconds(stamps[:, [colour, 1 - colour]].ravel(), str(file)).reshape(-1, 2), [(row[colour], row[1 - colour]) for row in files]


def read_list(path: Path, *, images: int = 1) -> tuple[NDArray[np.float64], list[tuple[Path, ...]]]:
    """Stamps (N, images) and files of the lines `stamp file`, or `stamp file stamp file` with 2 images, sorted by stamp.

    What follows in a line is ignored. A line that names no image is left out, with one warning, and so is the second of two equal lines.
    Raises RecordingError if no line is left.
    """
    rows: dict[tuple[tuple[float, ...], tuple[Path, ...]], None] = {}  # in the order of the file, each once
    problems = []
    for line, words in listed_lines(path):
        stamps = tuple(map(number, words[: 2 * images : 2]))
        found = [listed_image(path.parent, word) for word in words[1 : 2 * images : 2]]
        if len(found) < images or not np.isfinite(stamps).all():
            problems.append(f"line {line} is '{' '.join(words)[:100]}', expected a stamp in seconds and a file")
        elif missing := [f"{file} {problem}"[-200:] for file, problem in found if problem]:
            problems.append(f"line {line}: {missing[0]}")
        else:
            rows[stamps, tuple(file for file, _ in found)] = None
    if not rows:
        why = problems[0] if problems else "empty, expected lines of a stamp in seconds and a file"
        raise RecordingError(f"{path}: {why}")
    warn_left_out(str(path), problems)
    if backward := int((np.diff([stamps[0] for stamps, _ in rows]) < 0).sum()):
        log.warning("%s: %d stamps are earlier than the one in the line before; the images are sorted by their stamps", path, backward)
    ordered = sorted(rows)
    return np.array([stamps for stamps, _ in ordered]), [files for _, files in ordered]


def read_ground_truth(path: Path, timestamps: NDArray[np.float64]) -> Truth | None:
    """The pose nearest in time to each stamp (N,) [s] within 20 ms; None without the file."""
    return read_stamped(path, timestamps) if path.is_file() else None


READER = Reader(
    "tum", "rgb.txt, depth.txt", recognises, open_tum, likeness=Likeness("a TUM sequence", (part("rgb.txt"), part("depth.txt")))
)
