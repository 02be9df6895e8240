"""frames.csv: one line for each frame of a run.

Columns: index; timestamp [s]; final status (ok, degenerate, doubtful, lost or interpolated); keyframe (0 or 1); ms, from the end of the
previous frame to the end of this one; the status as it was reported at the time; by how much position [cm] and rotation [degrees] are
expected to be off, empty where that was not estimated; the share of pixels that show what moves [%]; then one column for each loss that
any frame has, empty for frames without it.
"""

import csv
import math
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.errors import ResultError
from idfslam.evaluation.doubt import ReportedFrames
from idfslam.frame import FrameResult, Status
from idfslam.geometry.trajectory import Trajectory
from idfslam.storage.state import State

_MOST_FRAMES = 1 << 31  # of a run; raised, larger numbers pass than arrays of indices hold everywhere
_FIXED = ("index", "timestamp", "status", "keyframe", "ms")
_LATER = ("live_status", "sigma_position_cm", "sigma_rotation_deg", "moving_percent")  # columns that files of older versions lack


@dataclass(frozen=True)
class FrameLine:
    """One frame of the log."""

    index: int
    timestamp: float  # [s]
    status: Status
    keyframe: bool
    ms: float
    losses: dict[str, float]
    live_status: Status  # as it was reported when the frame was processed
    sigma_position: float | None = None  # [m] as in `FrameResult`
    sigma_rotation: float | None = None  # [degrees]
    moving: float | None = None  # [1] share of pixels that show what moves


@dataclass(frozen=True)
class FrameLog:
    """The frames in their order."""

    lines: list[FrameLine] = field(default_factory=list)

    def add(self, result: FrameResult, ms: float) -> None:
        """Appends a frame, which took `ms`."""
        told, sigmas = (result.index, result.timestamp, result.status, result.keyframe), (result.sigma_position, result.sigma_rotation)
        self.lines.append(FrameLine(*told, ms, dict(result.losses), result.status, *sigmas, result.moving_share))

    def set_final_statuses(self, statuses: Sequence[Status]) -> None:
        """Replaces the statuses: lost frames may have become interpolated. A frame at which the run broke off has a status but no line."""
        self.lines[:] = [replace(line, status=status) for line, status in zip(self.lines, statuses)]

    def state(self) -> State:
        """The lines."""
        return {"lines": [asdict(line) for line in self.lines]}

    def restore(self, state: State) -> None:
        """Sets the lines that `state` returned."""
        self.lines[:] = [FrameLine(**(line | {name: Status(line[name]) for name in ("status", "live_status")})) for line in state["lines"]]

    def reported(self, live: Trajectory, corrected: Collection[int] = ()) -> ReportedFrames:
        """What was reported of each frame at the time. Covariances are not in the log.

        live: the poses reported. corrected: frames at which a closed loop moved the camera. Raises ResultError if there is not a pose for
        each line.
        """
        if len(live) != len(self.lines):
            raise ResultError(f"{len(live)} poses were reported of {len(self.lines)} frames; expected one for each")
        keyframes, unknown = np.array([line.keyframe for line in self.lines], bool), np.full((len(live), 6, 6), np.nan)
        statuses = [line.live_status for line in self.lines]
        return ReportedFrames(live.timestamps, live.poses, statuses, keyframes, unknown, corrected)

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
            writer.writerow([*_FIXED, *_LATER, *names])
            for line in self.lines:
                losses = [f"{line.losses[name]:.6g}" if name in line.losses else "" for name in names]
                fixed = (line.index, f"{line.timestamp:.6f}", line.status.value, int(line.keyframe), f"{line.ms:.2f}")
                moving = None if line.moving is None else 100 * line.moving
                sigmas = (line.sigma_position and 100 * line.sigma_position, line.sigma_rotation, moving)
                later = (line.live_status.value, *("" if sigma is None else f"{sigma:.4g}" for sigma in sigmas))
                writer.writerow([*fixed, *later, *losses])

    @staticmethod
    def load(path: Path) -> "FrameLog":
        """Reads a file that `save` wrote. Raises ResultError if it is not one."""
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file, restkey="", restval="")
            try:
                return FrameLog([_line(row) for row in reader])
            except (ValueError, csv.Error) as error:
                expected = f"one line for each frame: {', '.join(_FIXED)}, losses"
                raise ResultError(f"{path}:{reader.line_num}: not the log of a run ({error}); expected {expected}") from error


def _line(row: dict[str, str]) -> FrameLine:
    if absent := [name for name in _FIXED if name not in row]:
        raise ValueError(f"no column {', '.join(absent)}")
    if "" in row:
        raise ValueError("more values than columns")
    losses = {name: float(value) for name, value in row.items() if name not in (*_FIXED, *_LATER) and value}
    index, timestamp, ms = int(row["index"]), float(row["timestamp"]), float(row["ms"])
    if not 0 <= index < _MOST_FRAMES:
        raise ValueError(f"frame {row['index'][:20]}")
    position, rotation, moving = (float(row[name]) if row.get(name) else None for name in _LATER[1:])
    live_status, metres = Status(row.get(_LATER[0]) or row["status"]), None if position is None else position / 100
    told, later = (index, timestamp, Status(row["status"]), bool(int(row["keyframe"])), ms, losses), (live_status, metres, rotation)
    return FrameLine(*told, *later, None if moving is None else moving / 100)
