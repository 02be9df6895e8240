"""The true trajectory of a run from a file that somebody else wrote: by time stamps, or by the order of the frames."""

import logging
from pathlib import Path

import numpy as np

from idfslam.datasets.poses.pose_file import read_pose_file
from idfslam.datasets.poses.truth import warn_if_in_millimetres
from idfslam.datasets.recording import FPS
from idfslam.datasets.time_stamps import in_seconds_near
from idfslam.geometry.association import TOLERANCE, associate
from idfslam.geometry.trajectory import Trajectory, TrajectoryError

log = logging.getLogger(__name__)

_ROUNDED = 1e-3  # [1] of a frame's time by which assumed stamps are rounded in trajectory.txt; raised, measured stamps count as assumed
_LATEST = 1e6  # [s] of assumed stamps, which begin at 0; raised, stamps since 1970 that lie on the same grid count as assumed


def read_truth(path: Path, run: Trajectory) -> Trajectory:
    """Reads the true poses of a run's frames, in any form that `read_pose_file` knows.

    Stamps decide which pose belongs to which frame. Where the file has none, and where the run's own are assumed and none is near a true
    one, as many poses as frames are taken in their order, and a line says so: then no other reading is possible, and a wrong one would show
    as a large error. Raises RecordingError for a file of another form and TrajectoryError if a line is no pose or nothing fits the run.
    """
    file = read_pose_file(path)
    if file.problems:
        more = f" (and {len(file.problems) - 1} lines more)" if len(file.problems) > 1 else ""
        raise TrajectoryError(f"{file.problems[0]}{more}")
    warn_if_in_millimetres(file.T_wc, str(path))
    if file.timestamps is None:
        if len(file.T_wc) != len(run):
            found = f"{len(file.T_wc)} poses without time stamps for {len(run)} frames"
            raise TrajectoryError(f"{path}: {found}; expected one for each frame, or lines of stamp tx ty tz qx qy qz qw")
        log.warning("%s: has no time stamps; its poses are taken in the order of the frames", path)
        return Trajectory(run.timestamps, file.T_wc)
    truth = Trajectory(in_seconds_near(file.timestamps, run.timestamps), file.T_wc)
    if len(run) and has_assumed_stamps(run) and not len(associate(run.timestamps, truth.timestamps)):
        return _in_order(path, truth, run)
    return truth


def has_assumed_stamps(run: Trajectory) -> bool:
    """Whether the stamps of a run are those of a recording that has none: multiples of 1/30 s from 0 on."""
    frames = run.timestamps * FPS
    return bool(np.all(np.abs(frames - np.round(frames)) < _ROUNDED + 1e-6 * FPS) and run.timestamps.max() < _LATEST)


def _in_order(path: Path, truth: Trajectory, run: Trajectory) -> Trajectory:
    spans = f"{truth.timestamps.min():.3f} to {truth.timestamps.max():.3f} s, those of the run ({FPS:.0f} frames/s assumed) others"
    if len(truth) != len(run):
        counts = f"it has {len(truth)} poses for {len(run)} frames"
        fix = "give the recording's stamps in timestamps.txt and run again, or one pose for each frame"
        raise TrajectoryError(f"{path}: its stamps are {spans}, none within {TOLERANCE} s, and {counts}; {fix}")
    log.warning("%s: its stamps are %s; its poses are taken in the order of the frames", path, spans)
    order = np.argsort(truth.timestamps, kind="stable")
    return Trajectory(run.timestamps, truth.poses[order])
