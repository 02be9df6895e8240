"""A trajectory.txt without the frames whose pose was not measured, and the trajectory of all frames from it."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.trajectory import Trajectory, load_tum, save_tum
from idfslam.runs import result_folder
from idfslam.runs.frame_log import FrameLog


def leave_out_lost(folder: Path) -> Trajectory:
    """Rewrites trajectory.txt of a finished run without the frames whose pose was not measured, and returns it.

    frames.csv keeps a line for each frame. Raises ResultError if a file is missing or cannot be written.
    """
    log = FrameLog.load(result_folder.existing(folder, result_folder.FRAMES))
    trajectory, _ = of_all_frames(load_tum(result_folder.existing(folder, result_folder.TRAJECTORY)), log)
    kept = measured_frames(log)
    measured = Trajectory(trajectory.timestamps[kept], trajectory.poses[kept])
    with result_folder.writing(folder), result_folder.ledger(folder).replacing(result_folder.TRAJECTORY) as part:
        save_tum(part, measured)
    return measured


def measured_frames(log: FrameLog) -> NDArray[np.int64]:
    """The indices (M,) of the frames whose pose was measured."""
    return np.array([line.index for line in log.lines if line.status.measured], np.int64)


def of_all_frames(listed: Trajectory, log: FrameLog | None) -> tuple[Trajectory, NDArray[np.int64]]:
    """The trajectory of all frames of a run, and the indices of those that trajectory.txt (`listed`) holds.

    A frame that was left out has the pose of the last measured frame before it, and before the first one that of the first.
    """
    measured = np.arange(0) if log is None else measured_frames(log)
    if log is None or len(listed) != len(measured) or len(listed) == len(log.lines) or not len(listed):
        return listed, np.arange(len(listed))
    nearest = np.searchsorted(measured, np.arange(len(log.lines)), side="right") - 1
    stamps = np.array([line.timestamp for line in log.lines])
    return Trajectory(stamps, listed.poses[nearest.clip(0)]), measured
