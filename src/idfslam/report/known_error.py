"""The error of a run's trajectory, where the truth is known."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets import Dataset
from idfslam.evaluation.trajectory_error import AbsoluteTrajectoryError, absolute_trajectory_error, matched_ground_truth
from idfslam.evaluation.truth_file import read_truth
from idfslam.runs.finished_run import FinishedRun


@dataclass(frozen=True, eq=False)
class KnownError:
    """The absolute trajectory error, and the true poses (N, 4, 4), NaN where a frame has none."""

    ate: AbsoluteTrajectoryError
    truth: NDArray[np.float64]

    @staticmethod
    def of(run: FinishedRun, recording: Dataset | None, gt: Path | None) -> "KnownError | None":
        """That against the file `gt`, or against the recording's own truth; None without any truth."""
        if gt is not None:
            truth = matched_ground_truth(run.trajectory, read_truth(gt, run.trajectory))
        elif recording is not None and recording.ground_truth is not None:
            truth = recording.ground_truth[: len(run.trajectory)]
        else:
            return None
        known = np.isfinite(truth).all((1, 2)).any()
        return KnownError(absolute_trajectory_error(run.trajectory.poses, truth), truth) if known else None

    def per_frame(self, frames: int) -> NDArray[np.float64]:
        """(N,) the distance [m] of each frame's position from the true one, NaN where it is unknown."""
        errors = np.full(frames, np.nan)
        errors[self.ate.frames] = self.ate.errors
        return errors

    def true_positions(self) -> NDArray[np.float64]:
        """(N, 3) the true positions in the world of the run [m]."""
        T_est_gt = np.linalg.inv(self.ate.T_gt_est)
        return np.asarray(self.truth[:, :3, 3] @ T_est_gt[:3, :3].T + T_est_gt[:3, 3])
