"""The depth range of a recording: the nearest and the farthest depth that its sensor read.

A sensor has no readings outside its range: surface there is in view and yet not in the recording. The range is measured from the readings,
since recordings seldom name their camera.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.recording import Dataset
from idfslam.errors import FrameError
from idfslam.geometry.even_spacing import evenly_spread

_FRAMES = 20  # that are read, spread evenly over the recording; raised, the range is more exact and takes longer. Chosen by hand
_OUTLIERS = 1e-3  # [1] share of readings left out at either end (reflections, mixed pixels); raised, the range shrinks. Chosen by hand


@dataclass(frozen=True)
class DepthRange:
    """Nearest and farthest z-depth [m]."""

    near: float
    far: float


def depth_range(recording: Dataset) -> DepthRange | None:
    """The range of the readings of 20 frames without the nearest and the farthest thousandth; None if these frames hold no readings."""
    readings = np.concatenate([np.zeros(0, np.float32), *_readings(recording)])
    if len(readings) == 0:
        return None
    near, far = np.quantile(readings, [_OUTLIERS, 1 - _OUTLIERS], method="nearest")
    return DepthRange(float(near), float(far))


def _readings(recording: Dataset) -> Iterator[NDArray[np.float32]]:
    for i in evenly_spread(len(recording), _FRAMES).tolist():
        try:
            depth = recording[i].depth
        except FrameError:
            continue
        yield depth[depth > 0]
