"""SUN3D (Xiao et al., ICCV 2013): image/NUMBER-MICROSECONDS.jpg, depth/NUMBER-MICROSECONDS.png, intrinsics.txt.

Depth is in millimetres, its 16 bits turned by 3 places to the left. Images are paired by the nearest stamp.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration, assumed_scale
from idfslam.datasets.images.decoding import Depth, ImageFiles, numbered
from idfslam.datasets.images.pairs import pair_images
from idfslam.datasets.near_miss import Likeness, part
from idfslam.datasets.provenance import ASSUMED
from idfslam.datasets.recording import FPS, Reader, Recording
from idfslam.errors import RecordingError

_NAME = re.compile(r"\d{7}-\d{12}")


def recognises(path: Path) -> bool:
    return all(_has_names(path / name) for name in ("image", "depth"))


def _has_names(folder: Path) -> bool:
    return any(_NAME.fullmatch(file.stem) for file in folder.glob("*-*"))


def open_sun3d(path: Path, stated: Calibration) -> Recording:
    """Opens a sequence. Its poses, of structure from motion, are not read."""
    if not recognises(path):
        raise RecordingError(f"{path}: expected image/ and depth/ with files named NUMBER-MICROSECONDS, as SUN3D has them")
    pairs = pair_images(numbered(path / "image"), numbered(path / "depth"), path)
    timestamps = pairs.places / FPS if pairs.stamps is None else pairs.stamps
    return Recording(
        path.name,
        TurnedDepth(ImageFiles(pairs.files)),
        timestamps=timestamps,
        depth_timestamps=pairs.depth_timestamps(timestamps),
        stamps_source=ASSUMED if pairs.stamps is None else "file names",
        ground_truth=None,
        calibration=stated.over(assumed_scale(1000, "SUN3D layout")),
    )


@dataclass(frozen=True)
class TurnedDepth:
    """Called with i, returns colour and depth of pair i, the bits of depth turned back."""

    read: ImageFiles

    def __call__(self, i: int) -> tuple[NDArray[np.uint8], Depth | None]:
        bgr, raw = self.read(i)
        if raw is None:
            return bgr, None
        turned = np.asarray(raw, np.uint16)  # SUN3D has no other
        return bgr, (turned >> 3 | turned << 13).astype(np.uint16)


READER = Reader(
    "sun3d",
    "image/ and depth/ with files NUMBER-MICROSECONDS of SUN3D",
    recognises,
    open_sun3d,
    likeness=Likeness("a sequence of SUN3D", (part("image/*-????????????.jpg", "image/"), part("depth/*-????????????.png", "depth/"))),
)
