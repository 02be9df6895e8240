"""The depth range of a recording: from how near to how far its depth images hold readings.

A sensor reads nothing outside its range, so what lies there is in view and yet not in the recording. The range is taken from the readings
themselves, since recordings seldom say what camera made them.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.recording import Dataset
from idfslam.errors import FrameError

_FRAMES = 20  # spread evenly over the recording
_WILD = 1e-3  # share of readings at either end that does not count: reflections, mixed pixels


@dataclass(frozen=True)
class DepthRange:
    """Nearest and farthest z-depth [m]."""

    near: float
    far: float


def depth_range(recording: Dataset) -> DepthRange | None:
    """Of the readings of 20 frames, but for a thousandth of them at either end; None where none of these frames holds a reading."""
    readings = np.concatenate([np.zeros(0, np.float32), *_readings(recording)])
    if len(readings) == 0:
        return None
    near, far = np.quantile(readings, [_WILD, 1 - _WILD], method="nearest")
    return DepthRange(float(near), float(far))


def _readings(recording: Dataset) -> Iterator[NDArray[np.float32]]:
    for i in np.unique(np.linspace(0, len(recording) - 1, _FRAMES).round().astype(int)).tolist():
        try:
            depth = recording[i].depth
        except FrameError:
            continue
        yield depth[depth > 0]
