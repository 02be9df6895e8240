"""Consistency of reported covariances: are the errors as large as they say? (Bar-Shalom, Li, Kirubarajan 2001, Sec. 5.4)

A covariance describes a frame's pose in the map around it, not the drift of that map. The last keyframe stands for the map around it.
So the error is that of the motion since the last keyframe: with the keyframe's estimated pose laid on its true one, shift and turn from the
frame's estimated pose to its true one, along the world's axes. The keyframe's pose has an error too, and the two count as independent:
P = P_c + J P_k J^T, where J carries the keyframe's error to the frame (its turn moves the frame by the lever between them).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import gammaincinv

from idfslam.evaluation.doubt import ReportedFrames
from idfslam.evaluation.trajectory_error import has_truth

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MotionErrors:
    """The errors of the motion of some frames since the last keyframe, and their covariances."""

    errors: Floats  # (M, 6) shift [m], then turn [rad]
    covariances: Floats  # (M, 6, 6)
    trusted: NDArray[np.bool_]  # (M,) whether the frame was called good

    @staticmethod
    def of(reported: ReportedFrames, truth: Floats) -> "MotionErrors":
        """Those of all frames of a run that have a measured pose, a covariance and a truth, and whose last keyframe has a truth.

        A frame at which a loop moved the camera is left out: its keyframe's pose is of the world before.
        truth: (N, 4, 4) camera-to-world, NaN where a frame has none. Raises `TrajectoryError` if the shapes differ.
        """
        known = has_truth(reported.T_wc, truth)
        usable = known & np.isfinite(reported.covariances).all((1, 2)) & np.array([s.measured for s in reported.statuses], bool)
        usable[list(reported.corrected)] = False
        last = _last_keyframes(reported.keyframes)
        frames = np.array([i for i in np.flatnonzero(usable) if last[i] >= 0 and known[last[i]]], np.int64)
        keyframes = last[frames]
        T_wk, T_wc = reported.T_wc[keyframes], reported.T_wc[frames]
        T_true = T_wk @ np.linalg.inv(truth[keyframes]) @ truth[frames]
        turn = Rotation.from_matrix(T_true[:, :3, :3] @ T_wc[:, :3, :3].transpose(0, 2, 1)).as_rotvec() if len(frames) else np.zeros((0, 3))
        errors = np.concatenate([T_true[:, :3, 3] - T_wc[:, :3, 3], turn], -1)
        J, P_k = _carried(T_wc[:, :3, 3] - T_wk[:, :3, 3]), np.nan_to_num(reported.covariances[keyframes])  # none: the frame is the world
        trusted = np.array([reported.statuses[i].trusted for i in frames], bool)
        return MotionErrors(errors, reported.covariances[frames] + J @ P_k @ J.transpose(0, 2, 1), trusted)

    @staticmethod
    def joined(runs: Sequence["MotionErrors"]) -> "MotionErrors":
        """Those of several runs, at least one."""
        return MotionErrors(*(np.concatenate([getattr(run, name) for run in runs]) for name in ("errors", "covariances", "trusted")))

    def where(self, chosen: NDArray[np.bool_]) -> "MotionErrors":
        """Those of the chosen (M,) frames."""
        return MotionErrors(self.errors[chosen], self.covariances[chosen], self.trusted[chosen])

    def nees(self) -> Floats:
        """(M,) the normalised estimation error squared, over its 6 degrees of freedom: e^T P^-1 e / 6. Its mean is 1 if P is right.

        Raises `numpy.linalg.LinAlgError` if a covariance is singular.
        """
        return np.asarray((self.errors * np.linalg.solve(self.covariances, self.errors[..., None])[..., 0]).sum(-1) / 6)

    @property
    def sigmas(self) -> Floats:
        """(M, 2) the expected errors: the roots of the traces of the covariances of shift [m] and turn [rad]."""
        variances = np.diagonal(self.covariances, axis1=1, axis2=2)
        return np.sqrt(np.stack([variances[:, :3].sum(-1), variances[:, 3:].sum(-1)], -1))

    @property
    def sizes(self) -> Floats:
        """(M, 2) the lengths of shift [m] and turn [rad]."""
        return np.stack([np.linalg.norm(self.errors[:, :3], axis=-1), np.linalg.norm(self.errors[:, 3:], axis=-1)], -1)


def _last_keyframes(keyframes: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(N,) the last keyframe before each frame, -1 where there is none."""
    marked = np.where(keyframes, np.arange(len(keyframes)), -1)
    return np.concatenate([[-1], np.maximum.accumulate(marked)[:-1]]).astype(np.int64)[: len(keyframes)]


def _carried(lever: Floats) -> Floats:
    """(M, 6, 6) how a keyframe's error moves the motion to a frame that lies `lever` (M, 3) [m] from it: -I, and lever x turn."""
    x, y, z = lever.T
    zero = np.zeros_like(x)
    J = np.tile(-np.eye(6), (len(lever), 1, 1))
    J[:, :3, 3:] = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)
    return J


def share_inside(nees: Floats, probability: float = 0.95) -> float:
    """The share of frames whose NEES (N,) lies below the quantile of the chi-squared distribution of 6 degrees of freedom."""
    return float((nees * 6 <= 2 * gammaincinv(6 / 2, probability)).mean())


@dataclass(frozen=True)
class ReliabilityBin:
    """Frames of about one predicted error: both values are root mean squares, in one unit, and equal if the prediction is right."""

    frames: int
    predicted: float
    actual: float


def reliability(predicted: Floats, actual: Floats, bins: int = 8) -> list[ReliabilityBin]:
    """Frames (M,) sorted by their predicted error, in bins of equal numbers, fewer where there are not as many frames."""
    parts = np.array_split(np.argsort(predicted, kind="stable"), min(bins, len(predicted)) or 1)
    return [ReliabilityBin(len(part), _rms(predicted[part]), _rms(actual[part])) for part in parts if len(part)]


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
