"""Errors of a trajectory: absolute trajectory error (ATE) and relative pose error (RPE), as defined by Sturm et al., IROS 2012.

Poses are camera-to-world (N, 4, 4); a frame without ground truth has NaN there and is left out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idfslam.geometry.association import TOLERANCE, associate
from idfslam.geometry.trajectory import Trajectory, TrajectoryError, align

Poses = NDArray[np.float64]

_AROUND = 2.0  # [m] distance of a camera from what it sees, about the depth of a room; raised, turns count more than shifts. Chosen by hand


@dataclass(frozen=True)
class Statistics:
    """Statistics of the errors of all frames or pairs of frames, in the unit of the errors."""

    rmse: float
    mean: float
    median: float
    max: float
    std: float

    @staticmethod
    def of(errors: NDArray[np.float64]) -> "Statistics":
        """The statistics of errors (M,), M >= 1."""
        rmse = float(np.sqrt(np.mean(errors**2)))
        return Statistics(rmse, float(errors.mean()), float(np.median(errors)), float(errors.max()), float(errors.std()))


@dataclass(frozen=True, eq=False)
class AbsoluteTrajectoryError:
    """Distances between camera centres after rigid alignment."""

    translation: Statistics  # [m]
    frames: NDArray[np.int64]  # (M,) indices of the frames that have ground truth
    errors: NDArray[np.float64]  # (M,) [m]
    T_gt_est: NDArray[np.float64]  # (4, 4) the alignment


@dataclass(frozen=True)
class Jump:
    """The largest errors of the motion from a frame to the next. Its two parts may be of different frames."""

    translation_m: float
    translation_frame: int  # the frame that is reached
    rotation_deg: float
    rotation_frame: int


@dataclass(frozen=True, eq=False)
class RelativePoseError:
    """Errors of the motion over `delta` frames."""

    delta: int  # [frames]
    translation: Statistics  # [m]
    rotation: Statistics  # [degrees]
    frames: NDArray[np.int64]  # (M,) index of the first frame of each pair
    translation_errors: NDArray[np.float64]  # (M,) [m]
    rotation_errors: NDArray[np.float64]  # (M,) [degrees]

    @property
    def largest_jump(self) -> "Jump":
        """The largest of the errors of shift and turn, and the frames at which the motions that have them end."""
        shift, turn = self.translation_errors.argmax(), self.rotation_errors.argmax()
        frames = self.frames + self.delta
        return Jump(float(self.translation_errors[shift]), int(frames[shift]), float(self.rotation_errors[turn]), int(frames[turn]))


def matched_ground_truth(estimate: Trajectory, truth: Trajectory, *, tolerance: float = TOLERANCE) -> Poses:
    """(N, 4, 4) the true pose of every frame of the estimate, NaN if no stamp of the truth lies within `tolerance` [s].

    Raises `TrajectoryError` if no stamp matches.
    """
    pairs = associate(estimate.timestamps, truth.timestamps, tolerance=tolerance)
    if len(pairs) == 0:
        raise TrajectoryError(
            f"no time stamp of the estimate ({_span(estimate)}) lies within {tolerance} s of one of the ground truth ({_span(truth)}); "
            "give the ground truth of the same recording, in seconds"
        )
    poses = np.full((len(estimate), 4, 4), np.nan)
    poses[pairs[:, 0]] = truth.poses[pairs[:, 1]]
    return poses


def _span(trajectory: Trajectory) -> str:
    return f"{trajectory.timestamps.min():.3f} to {trajectory.timestamps.max():.3f} s" if len(trajectory) else "empty"


def first_pose_alignment(estimate: NDArray[np.float64], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """T_gt_est (4, 4) by the first frame with a true pose alone, of poses (N, 4, 4), true ones NaN where a frame has none.

    It is exact where that frame's estimate is, as in a map whose world is the first camera.
    """
    first = int(np.isfinite(truth).all((1, 2)).argmax())
    return np.asarray(truth[first] @ np.linalg.inv(estimate[first]))


def pose_alignment(estimate: NDArray[np.float64], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """T_gt_est (4, 4) that brings what the cameras see closest to where it is, of poses (N, 4, 4), NaN where a frame has none.

    Least squares over points 2 m from each camera, to either side along its axes. So turns count as well as shifts, and a straight or short
    path determines it too: the alignment of camera centres turns the map there by many degrees.
    """
    known = np.isfinite(truth).all((1, 2)) & np.isfinite(estimate).all((1, 2))
    return align(*(_points_around(poses[known]) for poses in (estimate, truth)))


def _points_around(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """(6 N, 3) the points 2 m from cameras at poses (N, 4, 4), to either side along their axes."""
    axes = _AROUND * np.concatenate([np.eye(3), -np.eye(3)])
    return np.asarray(axes @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]).reshape(-1, 3)


def absolute_trajectory_error(estimate: Poses, truth: Poses) -> AbsoluteTrajectoryError:
    """ATE of poses (N, 4, 4) against (N, 4, 4), aligned over all frames that have ground truth, without scale.

    Raises `TrajectoryError` if the shapes differ or no frame has ground truth.
    """
    frames = np.nonzero(has_truth(estimate, truth))[0]
    if len(frames) == 0:
        raise TrajectoryError("no frame has ground truth; the trajectory's error needs at least one")
    x, y = estimate[frames, :3, 3], truth[frames, :3, 3]
    T_gt_est = align(x, y)
    errors = np.linalg.norm(x @ T_gt_est[:3, :3].T + T_gt_est[:3, 3] - y, axis=-1)
    return AbsoluteTrajectoryError(Statistics.of(errors), frames, errors, T_gt_est)


def relative_pose_error(estimate: Poses, truth: Poses, *, delta: int = 1) -> RelativePoseError | None:
    """RPE of poses (N, 4, 4) against (N, 4, 4) over all pairs of frames i, i + delta that have ground truth; None if there is none."""
    valid = has_truth(estimate, truth)
    i = np.nonzero(valid[:-delta] & valid[delta:])[0]
    if len(i) == 0:
        return None
    translation, rotation = errors_of_motion(estimate[i], estimate[i + delta], truth[i], truth[i + delta])
    return RelativePoseError(delta, Statistics.of(translation), Statistics.of(rotation), i, translation, rotation)


def errors_of_motion(before: Poses, after: Poses, true_before: Poses, true_after: Poses) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The errors of the estimated motions between pairs of poses (M, 4, 4), against the true motions: (M,) [m] and (M,) [degrees]."""
    motion_estimate = np.linalg.inv(before) @ after
    motion_truth = np.linalg.inv(true_before) @ true_after
    error = np.linalg.inv(motion_truth) @ motion_estimate
    return np.linalg.norm(error[:, :3, 3], axis=-1), np.rad2deg(Rotation.from_matrix(error[:, :3, :3]).magnitude())


def has_truth(estimate: Poses, truth: Poses) -> NDArray[np.bool_]:
    """(N,) whether both poses of a frame are known. Raises `TrajectoryError` if the shapes are not (N, 4, 4) both."""
    if estimate.shape != truth.shape or estimate.shape[1:] != (4, 4):
        raise TrajectoryError(f"the estimate has poses {estimate.shape}, the ground truth {truth.shape}; expected (N, 4, 4) both")
    return np.asarray(np.isfinite(truth).all((1, 2)) & np.isfinite(estimate).all((1, 2)))
