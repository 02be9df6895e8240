"""Writes frames of a recording as undistorted image files, for formats of posed images."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets import Dataset
from idfslam.errors import FrameError, RecordingError
from idfslam.frame import Frame
from idfslam.pictures.image_files import write_colour, write_depth
from idfslam.storage import atomic_files

log = logging.getLogger(__name__)

COLOUR, DEPTH = "images", "depth"  # folders


@dataclass(frozen=True, eq=False)
class PosedImage:
    """A frame whose images are written to FOLDER/images/NAME and FOLDER/depth/NAME, with its pose."""

    name: str
    T_wc: NDArray[np.float64]  # (4, 4)
    frame: Frame


def write_images(
    folder: Path, recording: Dataset, indices: Sequence[int] | NDArray[np.int64], poses: NDArray[np.float64]
) -> list[PosedImage]:
    """Writes colour (8-bit PNG) and depth (16-bit PNG, millimetres) of the frames `indices`. poses: T_wc (N, 4, 4) of all frames.

    An unreadable frame is reported and left out. Raises RecordingError if none is left, ResultError if the folder cannot be written to.
    """
    for name in (COLOUR, DEPTH):
        atomic_files.prepare(folder / name)
    written = []
    for i in map(int, indices):
        try:
            frame = recording[i]
        except FrameError as error:
            log.warning("%s; the frame is left out", error)
            continue
        name = f"{i:06d}.png"
        write_colour(folder / COLOUR / name, frame.colour)
        write_depth(folder / DEPTH / name, frame.depth)
        written.append(PosedImage(name, poses[i], frame))
    if not written:
        raise RecordingError(f"{recording.name}: none of the {len(indices)} frames to export can be read")
    return written
