"""Writes frames of a recording as undistorted image files, for formats of posed images."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.frame import Frame, Status
from idfslam.pictures.image_files import write_colour, write_depth
from idfslam.storage import atomic_files

COLOUR, DEPTH = "images", "depth"  # folders


@dataclass(frozen=True, eq=False)
class PosedImage:
    """A frame whose images are written to FOLDER/images/NAME and FOLDER/depth/NAME, with its pose."""

    name: str
    T_wc: NDArray[np.float64]  # (4, 4)
    frame: Frame
    status: Status = Status.OK


def write_images(folder: Path, images: Iterable[PosedImage]) -> list[PosedImage]:
    """Writes colour (8-bit PNG) and depth (16-bit PNG, millimetres); returns the images. Raises ResultError if `folder` is not writable."""
    for name in (COLOUR, DEPTH):
        atomic_files.prepare(folder / name)
    written = []
    for image in images:
        write_colour(folder / COLOUR / image.name, image.frame.colour)
        write_depth(folder / DEPTH / image.name, image.frame.depth)
        written.append(image)
    return written
