"""The keyframes that a camera is calibrated from: those of a finished run, or those that SLAM chooses in a recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from idfslam.adjustment.landmark_tracks import KeyframeView
from idfslam.adjustment.row_motion import KeyframeMotion
from idfslam.adjustment.sensor_times import SensorTime
from idfslam.config import Config
from idfslam.datasets import Dataset
from idfslam.errors import ConfigError, RecordingError
from idfslam.frame import Frame
from idfslam.geometry.sensor_timing import SYNCHRONISED
from idfslam.graph.keyframe import Keyframe
from idfslam.live import is_live
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.metrics import read_metrics
from idfslam.runs.progress import ProgressBar
from idfslam.runs.run_config import RecordingSource
from idfslam.runs.source import open_source, read_frames
from idfslam.sensing.rectification import Rectification, RowTimes, rectified
from idfslam.slam import Slam
from idfslam.slam.keyframe_adjustment.keyframe_motion import STAMPS, KeyframeMotions, motion_around, unknown_motion


@dataclass(frozen=True)
class Keyframes:
    """Keyframes of one map: their indices in the recording (K,), views, poses T_wk (K, 4, 4), and how they moved (K)."""

    recording: Dataset
    indices: NDArray[np.int64]
    views: Sequence[KeyframeView]
    poses: NDArray[np.float64]
    motions: Sequence[KeyframeMotion]
    times: Mapping[str, SensorTime] = field(default_factory=dict)  # of the sensor, as the run over the recording found them

    @property
    def time_sigmas(self) -> NDArray[np.float64]:
        """(3,) [s] standard deviations of colour's read-out, depth's, and depth's delay; zero where they are stated."""
        return np.array([self.times[name].sigma if name in self.times else 0.0 for name in vars(SYNCHRONISED)])

    def __getitem__(self, chosen: NDArray[np.bool_]) -> "Keyframes":
        kept = np.flatnonzero(chosen).tolist()
        views, motions = [self.views[i] for i in kept], [self.motions[i] for i in kept]
        return replace(self, indices=self.indices[chosen], views=views, poses=self.poses[chosen], motions=motions)


def recording_of(source: RecordingSource) -> Dataset:
    """The recording, or that of the result folder. Raises ConfigError for a live camera."""
    if is_live(source.path):
        raise ConfigError(f"{source.path}: a live camera, expected a recording: record it first, with `idf-slam record`")
    run = _run_of(source)
    return open_source(source, report=True) if run is None else run.recording


def keyframes_of(source: RecordingSource, recording: Dataset, config: Config, console: Console | None) -> list[Keyframes]:
    """The keyframes of a recording by SLAM, or of a result folder; those of each submap by themselves."""
    run = _run_of(source)
    if run is None:
        return keyframes_by_slam(recording, config, console, source)
    indices, poses = run.keyframes.indices, run.keyframes.poses
    times = _times(read_metrics(run.folder)) if (run.folder / result_folder.METRICS).is_file() else {}
    seen = [rectified_keyframe(run, recording[int(i)], times) for i in indices]
    return [Keyframes(recording, indices, [view for view, _ in seen], poses, [motion for _, motion in seen], times)]


def rectified_keyframe(run: FinishedRun, frame: Frame, times: Mapping[str, SensorTime]) -> tuple[KeyframeView, KeyframeMotion]:
    """A frame of a run as a synchronised global shutter would have seen it, and how the camera moved, by the poses and times of the run."""
    rows, likeliest = row_times(frame, {name: time for name, time in times.items() if time.is_sure}), row_times(frame, times)
    if likeliest.synchronised:
        return KeyframeView.of(frame), unknown_motion(rows)
    around = stretch_around(run.trusted, frame.index, STAMPS)
    stamps, poses = run.trajectory.timestamps, run.trajectory.poses
    found = motion_around(stamps[frame.index], stamps[around], poses[around], likeliest)
    if found is None:
        return KeyframeView.of(frame), unknown_motion(likeliest)
    if rows.synchronised:
        return KeyframeView.of(frame), found
    rectification = Rectification(rows, found.velocity)
    return KeyframeView.of(rectified(frame, rectification)), replace(found, rectification=rectification)


def row_times(frame: Frame, found: Mapping[str, SensorTime]) -> RowTimes:
    """The times of a frame's rows: those that it states, those that were found, or zero."""
    values = {name: time.value for name, time in found.items()}
    known = {name: values.get(name, 0.0) if stated is None else stated for name, stated in vars(frame.timing).items()}
    return RowTimes(known["readout"], known["depth_readout"], known["depth_delay"] + frame.depth_lag)


def stretch_around(chosen: NDArray[np.bool_], i: int, reach: int) -> slice:
    """The stretch of chosen places (N,) around the i-th, at most `reach` before and after it; empty if that is not chosen."""
    ends = np.flatnonzero(~np.concatenate([[False], chosen, [False]])) - 1  # the places that are not, and those before and after all
    if not chosen[i]:
        return slice(i, i)
    k = int(np.searchsorted(ends, i))
    return slice(max(int(ends[k - 1]) + 1, i - reach), min(int(ends[k]), i + reach + 1))


def keyframes_by_slam(
    recording: Dataset, config: Config, console: Console | None = None, source: RecordingSource | None = None
) -> list[Keyframes]:
    """The keyframes of a recording, those of each submap by themselves, at the poses that SLAM gives them. source: see `read_frames`."""
    slam = Slam(replace(config, refine=False, calibrate="off"))
    with ProgressBar(len(recording), console) as bar:
        done, start = 0, perf_counter()
        for frame, _ in read_frames(recording, source):
            result, done = slam.process(frame), done + 1
            kept = len(slam.graph.keyframes) if result.keyframe else None
            bar.update(result, frames_per_second=done / (perf_counter() - start), keyframes=kept)
    slam.finish()
    return keyframes_in(slam, recording)


def keyframes_in(slam: Slam, recording: Dataset) -> list[Keyframes]:
    """The keyframes of a finished run over a recording, those of each submap by themselves."""
    stored = slam.graph.keyframes
    if not stored:
        raise RecordingError(f"{recording.name}: none of {len(slam.frames)} frames has depth, so there is nothing to calibrate")
    groups = [[keyframe for keyframe in stored if keyframe.submap == submap] for submap in sorted({k.submap for k in stored})]
    times = _times(slam.figures())
    motions = KeyframeMotions(slam.frames, lambda keyframe: slam.front_end.likeliest_row_times(keyframe)[0])
    return [_keyframes(recording, group, motions, times) for group in groups]


def _keyframes(recording: Dataset, group: Sequence[Keyframe], motions: KeyframeMotions, times: Mapping[str, SensorTime]) -> Keyframes:
    indices, poses = np.array([k.index for k in group]), np.array([k.T_wk.numpy() for k in group])
    return Keyframes(recording, indices, [KeyframeView.of(k.frame) for k in group], poses, [motions.of(k) for k in group], times)


def _times(figures: Mapping[str, Any]) -> dict[str, SensorTime]:
    """The times of the sensor in the figures of a run; empty if none are unknown, or if nothing moved."""
    return {name: SensorTime(*found) for name, found in (figures.get("sensor_timing_estimates") or {}).items()}


def _run_of(source: RecordingSource) -> FinishedRun | None:
    """The run, if the source is a result folder."""
    folder = Path(source.path)
    is_run = (folder / result_folder.KEYFRAMES).is_file() and (folder / result_folder.CONFIG).is_file()
    return FinishedRun(folder) if is_run else None
