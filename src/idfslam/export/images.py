"""Frames of a recording as image files, undistorted, beside their poses."""

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
    """A frame that lies in files: FOLDER/images/NAME and FOLDER/depth/NAME."""

    name: str
    T_wc: NDArray[np.float64]  # (4, 4)
    frame: Frame


def write_images(
    folder: Path, recording: Dataset, indices: Sequence[int] | NDArray[np.int64], poses: NDArray[np.float64]
) -> list[PosedImage]:
    """Colour (8-bit PNG) and depth (16-bit PNG, millimetres) of frames `indices`, whose poses are `poses[index]` (N, 4, 4).

    A frame that cannot be read is reported and left out. Raises RecordingError where none is left, ResultError where the folder
    cannot be written to.
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
