"""The measured values of a run in metrics.json, and reading them again."""

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from idfslam.datasets import FrameSource
from idfslam.errors import ResultError
from idfslam.evaluation.evaluate import evaluate_poses
from idfslam.evaluation.evaluation import Evaluation
from idfslam.frame import Status
from idfslam.runs import result_folder
from idfslam.runs.meter import Meter

if TYPE_CHECKING:
    from idfslam.slam import Slam


def run_metrics(slam: "Slam", recording: FrameSource, meter: Meter, *, interrupted: bool) -> dict[str, Any]:
    """The values of metrics.json: speed, memory, counts of frames and keyframes, and the pose errors where ground truth is known."""
    metrics = meter.summary(slam.timings) | {"interrupted": interrupted}
    errors, live_errors = pose_errors(slam, recording), pose_errors(slam, recording, live=True)
    metrics |= keyframe_counts(slam) | ({} if errors is None else errors.to_dict())
    return metrics if live_errors is None else metrics | {"live_ate_m": live_errors.ate.translation.rmse}


def keyframe_counts(slam: "Slam") -> dict[str, Any]:
    """Counts of keyframes, of lost frames (interpolated ones included), of degenerate frames, and `Slam.figures`."""
    count = Counter(slam.statuses())
    return {
        "keyframes": sum(keyframe.submap == 0 for keyframe in slam.stored_keyframes()),
        "lost_frames": count[Status.LOST] + count[Status.INTERPOLATED],
        "interpolated_frames": count[Status.INTERPOLATED],
        "degenerate_frames": count[Status.DEGENERATE],
    } | slam.figures()


def pose_errors(slam: "Slam", recording: FrameSource, *, live: bool = False) -> Evaluation | None:
    """ATE and RPE of the poses; None where the recording has no ground truth.

    live: of each pose as it was when its frame was processed, before later frames and loops corrected it.
    """
    poses = slam.live_trajectory() if live else slam.trajectory()
    if recording.ground_truth is None:
        return None
    truth = recording.ground_truth[: len(poses)]
    measured = np.array([status.measured for status in slam.statuses()], bool)
    return evaluate_poses(poses, truth, measured=measured) if np.isfinite(truth).all((1, 2)).any() else None


def read_metrics(folder: Path) -> dict[str, Any]:
    """The values of a run's metrics.json. Raises ResultError if the file is missing or damaged."""
    path = result_folder.existing(folder, result_folder.METRICS)
    try:
        metrics: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ResultError(f"{path}: cannot be read ({error}); run again into this folder") from error
    return metrics


def ate_rmse(metrics: Mapping[str, Any]) -> float | None:
    """The RMSE [m] of the absolute trajectory error in metrics.json; None for a recording without ground truth."""
    return metrics["ate_m"]["rmse"] if "ate_m" in metrics else None


def measured_ate_rmse(metrics: Mapping[str, Any]) -> tuple[float, int] | None:
    """The same [m] over the frames whose pose was measured, and how many these are; None where all frames are, or it is unknown."""
    measured = metrics.get("measured")
    return (measured["ate_m"]["rmse"], measured["frames"]) if measured and measured["frames"] < metrics["frames"] else None


def headline(frames: int, frames_per_second: float, ate_m: float | None) -> str:
    """A run in one line: number of frames, speed, and the ATE RMSE [m] if there is one."""
    ate = "" if ate_m is None else f", ATE {ate_m * 100:.2f} cm"
    return f"{frames} frames, {frames_per_second:.2f} frames/s{ate}"
