"""A recording through Slam into a result folder."""

import logging
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from rich.console import Console

from idfslam import results
from idfslam.config import Config
from idfslam.datasets import Dataset, Prefetch, open_recording
from idfslam.errors import DivergedError, RecordingError
from idfslam.evaluation.report import Evaluation, plot_trajectory
from idfslam.evaluation.result import evaluate_poses
from idfslam.frame import Frame, FrameResult, Status
from idfslam.geometry.trajectory import Trajectory, save_tum
from idfslam.metrics import Meter
from idfslam.progress import ProgressBar
from idfslam.slam import Slam

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Run:
    """What a run left behind."""

    folder: Path
    trajectory: Trajectory  # one pose for every frame processed
    mesh: trimesh.Trimesh
    metrics: dict[str, Any]  # what metrics.json holds


def run(
    recording: Dataset,
    config: Config,
    folder: Path,
    *,
    source: results.Source | None = None,
    console: Console | None = None,
    make_slam: Callable[[Config], Slam] = Slam,
) -> Run:
    """Every frame of `recording` through Slam; all results into `folder`.

    Ctrl-C ends after the frame in hand and writes the results so far; a second one ends at once. A frame that cannot be read is
    reported and treated as lost. Raises ResultError before anything is computed if the folder cannot be written to, and
    after the poses so far are written DivergedError, or RecordingError if no frame could be used.
    """
    results.prepare(folder)
    if config.field.encoding == "grid":
        torch.set_num_threads(1)  # its tensors are small and Numba uses the cores: threads that wait for each other cost half the rate
    slam = make_slam(config)
    meter = Meter()
    with stop_on_interrupt() as stop, ProgressBar(len(recording), console) as bar:
        try:
            unreadable = _process(slam, recording, meter, bar, stop)
            bar.describe("refining")
            if not slam.graph.keyframes:
                raise RecordingError(f"{recording.name}: none of {len(slam.statuses())} frames has depth, so there is nothing to map")
            slam.finish()
        except (DivergedError, RecordingError):
            results.remove_stale(folder, written=_write_poses(folder, slam, recording, config, source))
            raise
        metrics = meter.summary(slam.timings) | {"interrupted": stop.is_set(), "unreadable_frames": unreadable}
        errors = evaluation(slam, recording)
        metrics |= counts(slam) | ({} if errors is None else errors.to_dict())
        bar.describe("writing")
        mesh = slam.mesh(config.mesh.resolution)
        written = _write_poses(folder, slam, recording, config, source) | _write_map(folder, slam, mesh)
        results.write_json(folder / results.METRICS, metrics)
        results.remove_stale(folder, written=written | {results.METRICS})
    return Run(folder, _trajectory(slam, recording), mesh, metrics)


def open_source(source: results.Source) -> Dataset:
    """The recording and the frames of it that a run was, or is to be, made of. Raises RecordingError or ConfigError."""
    return open_recording(
        source.path,
        format=source.format,
        camera=source.camera,
        depth_scale=source.depth_scale,
        topics=source.topics,
        start=source.start,
        frames=source.frames,
        stride=source.stride,
    )


def frames(recording: Dataset) -> Iterator[tuple[Frame, bool]]:
    """Each frame, read ahead, and whether it could be read; a blank one stands for one that could not."""
    for i, frame in Prefetch(recording):
        if isinstance(frame, Frame):
            yield frame, True
        else:
            log.warning("%s; the frame is treated as lost", frame)
            yield Frame.blank(i, float(recording.timestamps[i]), recording.camera), False


def _process(slam: Slam, recording: Dataset, meter: Meter, bar: ProgressBar, stop: threading.Event) -> int:
    """Frames through Slam until the end or the first Ctrl-C; how many of them could not be read."""
    unreadable = 0
    for frame, readable in frames(recording):
        unreadable += not readable
        result: FrameResult = slam.process(frame)
        meter.frame()
        bar.update(result, frames_per_second=meter.frames_per_second)
        if stop.is_set():
            log.warning("interrupted after frame %d of %d: writing the results so far", frame.index, len(recording))
            break
    return unreadable


@contextmanager
def stop_on_interrupt() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C sets; the second one interrupts as usual. Outside the main thread Ctrl-C is left alone."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    usual = signal.getsignal(signal.SIGINT)

    def on_interrupt(number: int, frame: FrameType | None) -> None:
        stop.set()
        signal.signal(signal.SIGINT, usual)

    signal.signal(signal.SIGINT, on_interrupt)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, usual)


def counts(slam: Slam) -> dict[str, int]:
    """How many keyframes are stored, and how many frames are lost or degenerate."""
    statuses = slam.statuses()
    lost, degenerate = (sum(status is kind for status in statuses) for kind in (Status.LOST, Status.DEGENERATE))
    return {"keyframes": len(slam.graph.keyframes), "lost_frames": lost, "degenerate_frames": degenerate}


def evaluation(slam: Slam, recording: Dataset) -> Evaluation | None:
    """ATE and RPE where the recording has ground truth; None where it has none."""
    poses = slam.trajectory()
    if recording.ground_truth is None:
        return None
    truth = recording.ground_truth[: len(poses)]
    return evaluate_poses(poses, truth) if np.isfinite(truth).all((1, 2)).any() else None


def _trajectory(slam: Slam, recording: Dataset) -> Trajectory:
    poses = slam.trajectory()
    return Trajectory(recording.timestamps[: len(poses)], poses)


def _write_poses(folder: Path, slam: Slam, recording: Dataset, config: Config, source: results.Source | None) -> set[str]:
    """Trajectory, keyframes, config and the trajectory's picture; the names of the files."""
    trajectory = _trajectory(slam, recording)
    with results.replacing(folder / results.TRAJECTORY) as part:
        save_tum(part, trajectory)
    indices = np.array([keyframe.index for keyframe in slam.graph.keyframes], np.int64)
    poses = np.array([np.asarray(keyframe.T_wk) for keyframe in slam.graph.keyframes], np.float64).reshape(-1, 4, 4)
    results.write_keyframes(folder, results.KeyframeRecord(recording.camera, indices, recording.timestamps[indices], poses))
    results.write_config(folder, config, source)
    _draw(folder, slam, recording, indices)
    return {results.TRAJECTORY, results.KEYFRAMES, results.CONFIG, results.PICTURE}


def _draw(folder: Path, slam: Slam, recording: Dataset, keyframes: NDArray[np.int64]) -> None:
    """The trajectory's picture, beside the true one where there is one."""
    errors, poses = evaluation(slam, recording), slam.trajectory()
    truth = None if errors is None or recording.ground_truth is None else recording.ground_truth[: len(poses)]
    T_gt_est = None if errors is None or errors.ate is None else errors.ate.T_gt_est
    with results.replacing(folder / results.PICTURE) as part:
        plot_trajectory(part, poses, truth, T_gt_est=T_gt_est, keyframes=keyframes)


def _write_map(folder: Path, slam: Slam, mesh: trimesh.Trimesh) -> set[str]:
    """Mesh and map; the names of the files."""
    with results.replacing(folder / results.MESH) as part:
        mesh.export(part)
    with results.replacing(folder / results.MAP) as part:
        slam.save_map(part)
    return {results.MESH, results.MAP}
