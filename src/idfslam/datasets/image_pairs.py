"""Which colour and depth image of two series belong together: by equal numbers, by the nearest time stamp, or by their order."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.file_numbers import name_stamps
from idfslam.datasets.images import paired
from idfslam.errors import RecordingError
from idfslam.geometry.association import associate

log = logging.getLogger(__name__)

_SAME_NUMBERS = 0.5  # [1] share of images with a partner of the same number from which on numbers decide; raised, order decides more often.
#    Chosen by hand


@dataclass(frozen=True)
class ImagePairs:
    """N pairs in the order of time."""

    files: list[tuple[Path, Path]]  # colour, depth
    numbers: list[float]  # of the colour images
    stamps: NDArray[np.float64] | None  # (N,) [s], if the files are named by them


def pair_images(colour: dict[float, Path], depth: dict[float, Path], folder: Path) -> ImagePairs:
    """Pairs images, each by its number and sorted by it; raises RecordingError if they do not belong together."""
    stamps, depth_stamps = (name_stamps([file.stem for file in files.values()]) for files in (colour, depth))
    same = len(colour.keys() & depth.keys())
    if colour.keys() != depth.keys() and stamps is not None and depth_stamps is not None:
        return _by_stamps(colour, depth, stamps, depth_stamps, folder)
    if same < _SAME_NUMBERS * max(len(colour), len(depth)) or (same < len(colour) and _consecutive(colour) and _consecutive(depth)):
        return _by_order(colour, depth, depth_stamps if stamps is None else stamps, folder)
    return ImagePairs(paired(colour, depth, folder), list(colour), stamps)


def _consecutive(files: dict[float, Path]) -> bool:
    return bool(np.all(np.diff(list(files)) == 1))


def _by_stamps(
    colour: dict[float, Path], depth: dict[float, Path], stamps: NDArray[np.float64], depth_stamps: NDArray[np.float64], folder: Path
) -> ImagePairs:
    """Each colour image with the depth image nearest in time, at most half a frame away."""
    half = float(np.median(np.diff(stamps))) / 2 if len(stamps) > 1 else np.inf
    pairs = associate(stamps, depth_stamps, tolerance=half)
    if not len(pairs):
        spans = " and ".join(f"{times[0]:.3f} to {times[-1]:.3f} s" for times in (stamps, depth_stamps))
        raise RecordingError(f"{folder}: colour and depth images are named {spans}, none within half a frame: expected stamps of one clock")
    if len(pairs) < max(len(colour), len(depth)):
        counts = (len(colour), len(depth), len(pairs))
        log.warning("%s: %d colour and %d depth images; the %d pairs within half a frame of each other are read", folder, *counts)
    numbers, first, second = list(colour), list(colour.values()), list(depth.values())
    files = [(first[i], second[k]) for i, k in pairs.tolist()]
    return ImagePairs(files, [numbers[i] for i in pairs[:, 0]], stamps[pairs[:, 0]])


def _by_order(colour: dict[float, Path], depth: dict[float, Path], stamps: NDArray[np.float64] | None, folder: Path) -> ImagePairs:
    files = list(zip(colour.values(), depth.values()))
    if not files or len(colour) != len(depth):
        return ImagePairs(paired(colour, depth, folder), list(colour), stamps)
    names = (f"{file.parent.name}/{file.name}" for file in files[0])
    log.warning("%s: colour and depth images have different numbers; they are paired in their order: %s with %s", folder, *names)
    return ImagePairs(files, list(colour), stamps)
