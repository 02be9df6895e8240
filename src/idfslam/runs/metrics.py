"""The measured values of a run in metrics.json, and reading them again."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from idfslam.datasets import FrameSource, Selection
from idfslam.datasets.input_summary import summarise
from idfslam.errors import ResultError
from idfslam.evaluation.doubt import DoubtRates, doubt_rates
from idfslam.evaluation.evaluate import evaluate_poses
from idfslam.evaluation.evaluation import Evaluation
from idfslam.frame import Status
from idfslam.geometry.trajectory import Trajectory
from idfslam.runs import result_folder
from idfslam.runs.frame_log import FrameLog
from idfslam.runs.meter import Meter
from idfslam.storage.json_file import read_json
from idfslam.storage.plain_values import shown

if TYPE_CHECKING:
    from idfslam.slam import Slam

# Values of metrics.json that other commands show as numbers
_NUMBERS = (
    "frames",
    "seconds",
    "frames_per_second",
    "keyframes",
    "lost_frames",
    "degenerate_frames",
    "doubtful_frames",
    "submaps",
    "peak_memory_mb",
)


def run_metrics(slam: "Slam", recording: FrameSource, meter: Meter, frame_log: FrameLog, *, interrupted: bool) -> dict[str, Any]:
    """The values of metrics.json: speed, memory, counts of frames and keyframes, and where ground truth is known the errors of the poses
    and of their statuses.
    """
    metrics = {"schema": result_folder.SCHEMA} | meter.summary(slam.timings) | {"interrupted": interrupted}
    errors, live_errors = pose_errors(slam, recording), pose_errors(slam, recording, live=True)
    summary = summarise(recording) if isinstance(recording, Selection) else None
    metrics |= {"input": summary.to_dict()} if summary else {}
    metrics |= keyframe_counts(slam) | ({} if errors is None else errors.to_dict())
    if live_errors is None:
        return metrics
    return metrics | {"live_ate_m": live_errors.ate.translation.rmse, "doubt": _doubt(slam, recording, frame_log, metrics).to_dict()}


def _doubt(slam: "Slam", recording: FrameSource, frame_log: FrameLog, metrics: Mapping[str, Any]) -> DoubtRates:
    """How well the statuses told which poses were wrong, for a recording with ground truth."""
    live, truth = slam.live_trajectory(), recording.ground_truth
    assert truth is not None
    reported = frame_log.reported(Trajectory(recording.timestamps[: len(live)], live), corrected_frames(metrics))
    return doubt_rates(reported, truth[: len(live)])


def corrected_frames(metrics: Mapping[str, Any]) -> set[int]:
    """The frames of a run at which a closed loop moved the camera. Raises ResultError if `loops` is not a list of pairs of frames."""
    try:
        return {max(int(i), int(j)) for i, j in metrics.get("loops") or ()}
    except (TypeError, ValueError, OverflowError) as error:
        raise ResultError(
            f"the loops in {result_folder.METRICS} are no pairs of frames ({shown(error)}); run again into this folder"
        ) from error


def keyframe_counts(slam: "Slam") -> dict[str, Any]:
    """Counts of keyframes, of lost frames (interpolated ones included), of degenerate and doubtful frames, and `Slam.figures`."""
    statuses = slam.statuses()
    count = Counter(statuses)
    return {
        "keyframes": kept_keyframes(slam),
        "lost_frames": count[Status.LOST] + count[Status.INTERPOLATED],
        "interpolated_frames": count[Status.INTERPOLATED],
        "degenerate_frames": count[Status.DEGENERATE],
        "doubtful_frames": count[Status.DOUBTFUL],
        "doubtful_share": count[Status.DOUBTFUL] / max(len(statuses), 1),
    } | slam.figures()


def kept_keyframes(slam: "Slam") -> int:
    """Number of stored keyframes of the reported submap. Frames that became keyframes are more: some are culled."""
    return sum(keyframe.submap == 0 for keyframe in slam.stored_keyframes())


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
    metrics = read_json(path, error=ResultError, expected="the measured values of a run: run again into this folder")
    wrong = [name for name, value in _numbers(metrics).items() if isinstance(value, bool) or not isinstance(value, int | float)]
    if not isinstance(metrics, dict) or wrong:
        found = f"'{wrong[0]}' is no number" if wrong else type(metrics).__name__
        raise ResultError(f"{path}: {found}, expected the measured values of a run: run again into this folder")
    return {name: value for name, value in metrics.items() if value is not None}


def _numbers(metrics: Any) -> dict[str, Any]:
    """The values of metrics.json that must be numbers, by name."""
    if not isinstance(metrics, dict):
        return {}
    found = {name: metrics[name] for name in _NUMBERS if metrics.get(name) is not None}
    for name, inner in (("ms_per_frame", None), ("ate_m", "rmse")):
        values = metrics.get(name, {})
        if not isinstance(values, dict):
            found[name] = None
        else:
            found |= {f"{name}.{key}": values.get(key) for key in (values if inner is None or not values else (inner,))}
    return found


def ate_rmse(metrics: Mapping[str, Any]) -> float | None:
    """The RMSE [m] of the absolute trajectory error in metrics.json; None for a recording without ground truth."""
    return metrics["ate_m"]["rmse"] if metrics.get("ate_m") else None


def measured_ate_rmse(metrics: Mapping[str, Any]) -> tuple[float, int] | None:
    """The same [m] over the frames whose pose was measured, and how many these are; None where all frames are, or it is unknown."""
    measured = metrics.get("measured")
    return (measured["ate_m"]["rmse"], measured["frames"]) if measured and measured["frames"] < metrics["frames"] else None


def headline(frames: int, frames_per_second: float, ate_m: float | None) -> str:
    """A run in one line: number of frames, speed, and the ATE RMSE [m] if there is one."""
    ate = "" if ate_m is None else f", ATE {ate_m * 100:.2f} cm"
    return f"{frames} frames, {frames_per_second:.2f} frames/s{ate}"
