"""Which colour and depth image of two series belong together: by equal numbers, by the nearest time stamp, or by their order.

Images without a partner are left out, with one warning.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.images.decoding import FilePair, by_number
from idfslam.datasets.images.file_numbers import counting_numbers, name_stamps
from idfslam.datasets.images.partners import of_frames, stamps_of, warn_without_own, with_nearest
from idfslam.errors import RecordingError
from idfslam.geometry.association import associate

log = logging.getLogger(__name__)

_SAME_NUMBERS = 0.5  # [1] share of images with a partner of the same number from which on numbers decide; raised, order decides more often.
#    Chosen by hand


_COUNTED = 0.9  # [1] share of names with a number of their own from which on numbers count the images; lowered, names that are codes are
#    taken for numbers. Chosen by hand
_NOTICEABLE = 1 / 3  # [1] of the time between frames, from which on a delay of depth is told; raised, fewer are. Chosen by hand


@dataclass(frozen=True, eq=False)
class Pairs:
    """N colour images in the order of time, with their depth images."""

    numbers: list[float]  # (N,) of the colour images
    files: list[FilePair]  # (N,)
    places: NDArray[np.int64]  # (N,) position among all frames, those that were left out included: the others keep their time
    frames: int  # how many all are
    stamps: NDArray[np.float64] | None = None  # (N,) [s], if the files are named by them
    depth_stamps: NDArray[np.float64] | None = None  # (N,) [s] likewise, NaN: the frame has no depth image; None: those of colour

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def has_depth(self) -> NDArray[np.bool_]:
        """(N,) whether each has a depth image."""
        return np.array([depth is not None for _, depth in self.files], bool)

    def depth_timestamps(self, timestamps: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """(N,) [s] the stamps of depth, NaN where there is none; None: those of colour, `timestamps` (N,)."""
        if self.depth_stamps is not None:
            return self.depth_stamps
        return None if self.has_depth.all() else np.where(self.has_depth, timestamps, np.nan)

    def with_nearest_depth(self, timestamps: NDArray[np.float64]) -> "Pairs":
        """The same; a frame without a depth image has the nearest one, if that is near in time. timestamps: (N,) [s] of both images."""
        if self.depth_stamps is not None or self.has_depth.all():
            return self
        partner = of_frames(self.has_depth, timestamps)
        depths = [*(depth for _, depth in self.files), None]  # the last one is number -1
        files = [(colour, depths[k]) for (colour, _), k in zip(self.files, partner.tolist())]
        return replace(self, files=files, depth_stamps=stamps_of(timestamps, partner))


def numbered_series(colour: Sequence[Path], depth: Sequence[Path], folder: Path) -> tuple[dict[float, Path], dict[float, Path]]:
    """Colour and depth images by the numbers in their names; by the places of their names in the alphabet if these hold no numbers.

    Raises RecordingError if two images of a series have the same number.
    """
    names = [{file.stem for file in files} for files in (colour, depth)]
    shared = len(names[0] & names[1])
    unique = len(names[0]) == len(colour) and len(names[1]) == len(depth)
    if not unique or shared < _SAME_NUMBERS * max(len(colour), len(depth), 1) or all(map(_counted, (colour, depth))):
        return by_number(colour), by_number(depth)
    log.warning("%s: the names of the images do not count them; they are taken in the order of the alphabet", folder)
    places = {name: float(place) for place, name in enumerate(sorted(names[0] | names[1]))}
    first, second = ({places[file.stem]: file for file in sorted(files)} for files in (colour, depth))
    return first, second


def _counted(files: Sequence[Path]) -> bool:
    numbers = [text for text in counting_numbers([file.stem for file in files]) if text is not None]
    return len({float(text) for text in numbers}) >= _COUNTED * len(files)


def pair_images(colour: dict[float, Path], depth: dict[float, Path], folder: Path) -> Pairs:
    """Pairs images, each by its number and sorted by it; raises RecordingError if they do not belong together.

    A colour image without a depth image of its own takes the nearest in time, if the files are named by their stamps, else none.
    """
    stamps, depth_stamps = (name_stamps([file.stem for file in files.values()]) for files in (colour, depth))
    same = len(colour.keys() & depth.keys())
    if colour.keys() != depth.keys() and stamps is not None and depth_stamps is not None:
        return _by_stamps(colour, depth, stamps, depth_stamps, folder)
    if same < _SAME_NUMBERS * max(len(colour), len(depth)) or (same < len(colour) and _consecutive(colour) and _consecutive(depth)):
        return _by_order(colour, depth, depth_stamps if stamps is None else stamps, folder)
    return _by_number(colour, depth, stamps, folder)


def _consecutive(files: dict[float, Path]) -> bool:
    return bool(np.all(np.diff(list(files)) == 1))


def _by_stamps(
    colour: dict[float, Path], depth: dict[float, Path], stamps: NDArray[np.float64], depth_stamps: NDArray[np.float64], folder: Path
) -> Pairs:
    """Each colour image with the depth image nearest in time, at most half a frame away."""
    half = float(np.median(np.diff(stamps))) / 2 if len(stamps) > 1 else np.inf
    pairs = associate(stamps, depth_stamps, tolerance=half)
    if not len(pairs):
        spans = " and ".join(f"{times[0]:.3f} to {times[-1]:.3f} s" for times in (stamps, depth_stamps))
        raise RecordingError(f"{folder}: colour and depth images are named {spans}, none within half a frame: expected stamps of one clock")
    partner = with_nearest(pairs, stamps, depth_stamps)
    warn_without_own(str(folder), len(pairs), len(colour))
    second = [*depth.values(), None]  # the last one is number -1
    files = [(file, second[k]) for file, k in zip(colour.values(), partner.tolist())]
    return Pairs(list(colour), files, np.arange(len(colour)), len(colour), stamps, stamps_of(depth_stamps, partner))


def _by_order(colour: dict[float, Path], depth: dict[float, Path], stamps: NDArray[np.float64] | None, folder: Path) -> Pairs:
    files: list[FilePair] = list(zip(colour.values(), depth.values()))
    if not files or len(colour) != len(depth):
        return _by_number(colour, depth, stamps if stamps is not None and len(stamps) == len(colour) else None, folder)
    names = (f"{file.parent.name}/{file.name}" for file in files[0] if file is not None)
    log.warning("%s: colour and depth images have different numbers; they are paired in their order: %s with %s", folder, *names)
    return Pairs(list(colour), files, np.arange(len(files)), len(files), stamps)


def _by_number(colour: dict[float, Path], depth: dict[float, Path], stamps: NDArray[np.float64] | None, folder: Path) -> Pairs:
    """stamps: (N,) [s] of the colour images."""
    return replace(paired(colour, depth, folder), stamps=stamps)


def paired(colour: dict[float, Path], depth: dict[float, Path], folder: Path) -> Pairs:
    """Colour images with the depth images of equal numbers.

    Raises RecordingError if there is no pair. A colour image without a partner has no depth, a depth image without one is left out; a
    warning each says how many there are.
    """
    if not colour and not depth:
        raise RecordingError(f"{folder}: no numbered images in its folders, expected colour and depth images with numbers in their names")
    everything = {**colour, **depth}
    numbers = sorted(colour)
    alone = [everything[number] for number in sorted(colour.keys() ^ depth.keys())]
    own = len(colour.keys() & depth.keys())
    if not (colour and depth):
        found, missing = ("colour", "depth") if colour else ("depth", "colour")
        raise RecordingError(f"{folder}: {len(everything)} {found} images, but no {missing} images: expected one of each for a frame")
    if not own:
        counts = f"{len(colour)} colour and {len(depth)} depth images"
        example = f"{alone[0].parent.name}/{alone[0].name}"
        raise RecordingError(f"{folder}: {counts}, none with a partner (the first is {example}): expected pairs of equal numbers")
    left_out = [path for number, path in sorted(depth.items()) if number not in colour]
    warn_left_out(str(folder), [f"{path.parent.name}/{path.name} has no partner of the same number" for path in left_out])
    places = np.searchsorted(sorted(everything), numbers)
    warn_without_own(str(folder), own, len(numbers))
    return Pairs(numbers, [(colour[number], depth.get(number)) for number in numbers], places, len(everything))


def noticeable_delay(colour: NDArray[np.float64], depth: NDArray[np.float64]) -> float:
    """[s] by which the depth images of pairs are later than colour in the median; 0 if that is less than a third of a frame.

    colour, depth: (N,) [s] the stamps of the pairs; NaN where there is no depth.
    """
    if len(colour) < 2 or np.isnan(depth).all():
        return 0.0
    delay = float(np.nanmedian(depth - colour))
    return delay if abs(delay) > _NOTICEABLE * float(np.median(np.diff(colour))) else 0.0


def warn_left_out(source: str, problems: Sequence[str]) -> None:
    """One warning about images that are left out, if there are any: how many, and what is wrong with the first."""
    if problems:
        many = f"{len(problems)} images are left out, the first because" if len(problems) > 1 else "1 image is left out:"
        log.warning("%s: %s %s", source, many, problems[0])
