"""frames.csv: what a run tells of each frame, a line each.

Columns: index; timestamp [s]; status (ok, degenerate, lost or interpolated) as it is in the end; keyframe (0 or 1); ms, from the end of
the frame before to the end of this one; then every loss that came up in the run, empty where a frame has none.
"""

import csv
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.errors import ResultError
from idfslam.frame import FrameResult, Status
from idfslam.storage.state import State

_FIXED = ("index", "timestamp", "status", "keyframe", "ms")


@dataclass(frozen=True)
class FrameLine:
    """One frame of the log."""

    index: int
    timestamp: float  # [s]
    status: Status
    keyframe: bool
    ms: float
    losses: dict[str, float]


@dataclass(frozen=True)
class FrameLog:
    """The frames in their order."""

    lines: list[FrameLine] = field(default_factory=list)

    def add(self, result: FrameResult, ms: float) -> None:
        """One more frame, which took `ms`."""
        self.lines.append(FrameLine(result.index, result.timestamp, result.status, result.keyframe, ms, dict(result.losses)))

    def settle(self, statuses: Sequence[Status]) -> None:
        """What is known of the frames now: some that were lost may have been found since. A frame that broke the run off has no line."""
        self.lines[:] = [replace(line, status=status) for line, status in zip(self.lines, statuses)]

    def state(self) -> State:
        """The lines."""
        return {"lines": [asdict(line) for line in self.lines]}

    def restore(self, state: State) -> None:
        """What `state` told."""
        self.lines[:] = [FrameLine(**(line | {"status": Status(line["status"])})) for line in state["lines"]]

    @property
    def losses(self) -> dict[str, NDArray[np.float64]]:
        """Each loss over the frames (N,), NaN where a frame has none."""
        names = dict.fromkeys(name for line in self.lines for name in line.losses)
        return {name: np.array([line.losses.get(name, math.nan) for line in self.lines]) for name in names}

    def save(self, path: Path) -> None:
        """Writes the lines under a header."""
        names = list(self.losses)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([*_FIXED, *names])
            for line in self.lines:
                found = [f"{line.losses[name]:.6g}" if name in line.losses else "" for name in names]
                writer.writerow([line.index, f"{line.timestamp:.6f}", line.status.value, int(line.keyframe), f"{line.ms:.2f}", *found])

    @staticmethod
    def load(path: Path) -> "FrameLog":
        """What `save` wrote. Raises ResultError where the file is not that."""
        try:
            with path.open(newline="", encoding="utf-8") as file:
                return FrameLog([_line(row) for row in csv.DictReader(file)])
        except (KeyError, ValueError, TypeError, csv.Error) as error:
            raise ResultError(f"{path}: not as a run writes it ({error}); expected a line a frame: {', '.join(_FIXED)}, losses") from error


def _line(row: dict[str, str]) -> FrameLine:
    losses = {name: float(value) for name, value in row.items() if name not in _FIXED and value}
    index, timestamp, ms = int(row["index"]), float(row["timestamp"]), float(row["ms"])
    return FrameLine(index, timestamp, Status(row["status"]), bool(int(row["keyframe"])), ms, losses)
