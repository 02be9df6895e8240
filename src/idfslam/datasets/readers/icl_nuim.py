"""ICL-NUIM in its "TUM RGB-D compatible PNGs" (Handa et al., ICRA 2014): associations.txt, rgb/, depth/, *.gt.freiburg.

The published camera has fy = -480, because the renderer's y axis points up in the camera and in the world: both frames are left-handed. The
images are stored top row first. Here both frames are mirrored, T_wc = F T F with F = diag(1, -1, 1, 1), and fy is +480; this is
right-handed, x right, y down, z forward. The published surface must be mirrored in y too to match the map. Stamps are frame numbers,
at 30 Hz.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.cameras.camera_files import CAM_PARAMS, read_depth_camera
from idfslam.datasets.images.decoding import ImageFiles
from idfslam.datasets.images.depth_units import usual_scale
from idfslam.datasets.images.file_list import listed_image, listed_lines
from idfslam.datasets.images.pairs import warn_left_out
from idfslam.datasets.near_miss import Likeness, part
from idfslam.datasets.poses.truth import Truth, read_stamped
from idfslam.datasets.provenance import ASSUMED
from idfslam.datasets.recording import FPS, Reader, Recording
from idfslam.datasets.recording_path import names
from idfslam.errors import RecordingError

PUBLISHED = Calibration(481.2, 480.0, 319.5, 239.5, 640, 480, source="the published camera of ICL-NUIM")
_NAME = re.compile(r"(^|[^a-z])icl([^a-z]|$)|living_room_traj|office_traj", re.IGNORECASE)
_DIGITS = 15  # of a frame number; raised, numbers come that a double does not hold
_F = np.diag([1.0, -1.0, 1.0, 1.0])


def recognises(path: Path) -> bool:
    """Recognised by the pose file, or by the folder's name unless cam_params.json gives another camera."""
    if not (path / "associations.txt").is_file():
        return False
    return any(path.glob("*.gt.freiburg")) or (any(map(_NAME.search, names(path))) and not (path / CAM_PARAMS).exists())


def open_icl_nuim(path: Path, stated: Calibration) -> Recording:
    numbers, pairs = read_associations(path / "associations.txt")
    return Recording(
        path.name,
        ImageFiles(pairs),
        timestamps=numbers / FPS,
        stamps_source=ASSUMED,
        ground_truth=lambda: read_ground_truth(path, numbers),
        calibration=stated.over(PUBLISHED).over(usual_scale(pairs, 5000, "ICL-NUIM layout")),
        depth_camera=read_depth_camera(path),
    )


def read_associations(path: Path) -> tuple[NDArray[np.float64], list[tuple[Path, Path]]]:
    """Frame numbers (N,) and (colour, depth) of the lines `number depth/N.png number rgb/N.png`, in either order.

    A line of another form, or whose images do not exist, is left out, with one warning. Raises RecordingError if no line is left.
    """
    if not path.is_file():
        raise RecordingError(f"{path.parent}: associations.txt is missing, expected the TUM RGB-D compatible PNGs of ICL-NUIM")
    rows: dict[int, tuple[Path, Path]] = {}
    problems = []
    for line, words in listed_lines(path):
        if len(words) != 4 or not words[0].isdecimal() or words[0] != words[2] or len(words[0]) > _DIGITS:
            problems.append(f"line {line} is '{' '.join(words)[:100]}', expected: number depth/N.png number rgb/N.png")
            continue
        first, second = (listed_image(path.parent, word) for word in words[1::2])
        (depth, _), (colour, _) = (first, second) if words[1].startswith("depth") else (second, first)
        if missing := [f"{file} {problem}"[-200:] for file, problem in (first, second) if problem]:
            problems.append(f"line {line}: {missing[0]}")
        else:
            rows[int(words[0])] = (colour, depth)
    if not rows:
        raise RecordingError(f"{path}: {problems[0] if problems else 'empty, expected lines of: number depth/N.png number rgb/N.png'}")
    warn_left_out(str(path), problems)
    numbers = sorted(rows)
    return np.array(numbers, np.float64), [rows[number] for number in numbers]


def read_ground_truth(path: Path, numbers: NDArray[np.float64]) -> Truth | None:
    """The poses (N, 4, 4) of the frames with these numbers (N,), with OpenCV's axes; NaN where a frame has no pose."""
    files = [*sorted(path.glob("*.gt.freiburg")), path / "groundtruth.txt"]
    if len(files) > 2:
        raise RecordingError(f"{path}: {len(files) - 1} files *.gt.freiburg, expected one: remove those of other sequences")
    if not files[0].is_file():
        return None
    truth = read_stamped(files[0], numbers)
    return replace(truth, T_wc=_F @ truth.T_wc @ _F)


READER = Reader(
    "icl_nuim",
    "associations.txt, *.gt.freiburg",
    recognises,
    open_icl_nuim,
    likeness=Likeness("an ICL-NUIM sequence", (part("associations.txt"), part("*.gt.freiburg"))),
)
