"""The measurements of a bundle adjustment: where keyframes see landmarks, and the readings of depth there."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.adjustment.row_motion import RowMotion

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Observations:
    """N sightings of landmarks in keyframes, sorted by landmark, then by keyframe. Each pair occurs once."""

    keyframe: Indices  # (N,)
    landmark: Indices  # (N,)
    uv: Array  # (N, 2) [px]
    root: Array  # (N, 2, 2) [1/px] square roots of the information of uv: root^T root
    reading: Array  # (N,) [m] depth as the sensor states it; 0: none
    reading_sigma: Array  # (N,) [m] its standard deviation
    slope: Array  # (N, 2) [m/px] of the readings around it, along rows and columns
    rows: RowMotion | None = None  # when they were seen; None: at the keyframes' time stamps

    def __len__(self) -> int:
        return len(self.keyframe)

    def __getitem__(self, chosen: NDArray[np.generic]) -> "Observations":
        rows = None if self.rows is None else self.rows[chosen]
        return Observations(**{name: part[chosen] for name, part in self.columns.items()}, rows=rows)

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """What was measured, without the times of rows."""
        return {name: part for name, part in vars(self).items() if name != "rows"}

    @property
    def distant(self) -> NDArray[np.bool_]:
        """(N,) whether no keyframe has depth of its landmark."""
        readings = np.bincount(self.landmark, weights=self.reading > 0)
        return np.asarray(readings[self.landmark] == 0)


def joined(parts: Sequence[Observations]) -> Observations:
    """All of the observations."""
    none, flat = np.zeros(0, np.int64), np.zeros((0, 2))
    nothing = Observations(none, none, flat, np.zeros((0, 2, 2)), np.zeros(0), np.zeros(0), flat)
    columns: dict[str, Any] = {name: np.concatenate([part.columns[name] for part in [nothing, *parts]]) for name in nothing.columns}
    return Observations(**columns)


def together(parts: Sequence[tuple[Array, Observations]]) -> tuple[Array, Observations]:
    """The landmarks (L, 3) of all parts, numbered one part after the other, and their observations."""
    firsts = np.cumsum([0, *(len(points) for points, _ in parts)])
    points = np.concatenate([np.zeros((0, 3)), *(points for points, _ in parts)])
    return points, joined([replace(seen, landmark=seen.landmark + first) for (_, seen), first in zip(parts, firsts)])


def determined(points: Array, seen: Observations) -> tuple[Array, Observations]:
    """Those of landmarks (L, 3) that two keyframes see, and that three measurements or more determine, and their observations."""
    counts = np.bincount(seen.landmark, minlength=len(points))
    readings = np.bincount(seen.landmark, weights=seen.reading > 0, minlength=len(points))
    kept = (counts >= 2) & (counts + readings >= 3)
    numbers = np.cumsum(kept) - 1
    seen = seen[kept[seen.landmark]]
    return points[kept], replace(seen, landmark=numbers[seen.landmark])
