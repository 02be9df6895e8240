"""Calibrates the camera of recordings from their keyframes, and writes the camera file that reads them rightly."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from scipy.optimize import least_squares

from idfslam.adjustment.camera_findings import findings
from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.landmark_tracks import View
from idfslam.adjustment.row_motion import KeyframeMotion
from idfslam.adjustment.self_calibration import EXPLAINED, Estimate, Footage, confirmed, of_size, self_calibrate, with_scale
from idfslam.adjustment.sensor_times import SensorTime, mean_times
from idfslam.config import Config
from idfslam.datasets import Dataset
from idfslam.datasets.cameras.calibration import TIMES
from idfslam.datasets.cameras.camera_json import DEFORMATION
from idfslam.datasets.provenance import Provenance, is_guessed, provenance
from idfslam.errors import ConfigError, RecordingError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.graph.keyframe import Keyframe
from idfslam.live import is_live
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.metrics import read_metrics
from idfslam.runs.progress import ProgressBar
from idfslam.runs.run_config import RecordingSource
from idfslam.runs.source import open_source, read_frames
from idfslam.sensing.depth_deformation import DepthDeformation
from idfslam.sensing.rectification import Rectification, RowTimes, rectified
from idfslam.slam import Slam
from idfslam.slam.keyframe_motion import STAMPS, KeyframeMotions, motion_around, unknown_motion
from idfslam.storage import atomic_files

log = logging.getLogger(__name__)

_MOST_KEYFRAMES = 120  # in all, evenly spread; more: slower, and more exact where a recording shows more. Chosen by hand
_GRID = 12  # points a side at which the distortion of two lenses in a row is fitted; more: slower, and no more exact


@dataclass(frozen=True)
class Keyframes:
    """Keyframes of one map: their indices in the recording (K,), views, poses T_wk (K, 4, 4), and how they moved (K)."""

    recording: Dataset
    indices: NDArray[np.int64]
    views: Sequence[View]
    poses: NDArray[np.float64]
    motions: Sequence[KeyframeMotion]
    times: Mapping[str, SensorTime] = field(default_factory=dict)  # of the sensor, as the run over the recording found them

    def __getitem__(self, chosen: NDArray[np.bool_]) -> "Keyframes":
        kept = np.flatnonzero(chosen).tolist()
        views, motions = [self.views[i] for i in kept], [self.motions[i] for i in kept]
        return replace(self, indices=self.indices[chosen], views=views, poses=self.poses[chosen], motions=motions)


class Calibrated(NamedTuple):
    """The camera of recordings."""

    estimate: Estimate
    recording: Dataset  # the first one, as it was read
    times: Mapping[str, SensorTime]  # of the sensor, by name: those that the recordings do not state


def calibrate(sources: Sequence[RecordingSource], config: Config, *, truth: bool, console: Console | None = None) -> Calibrated:
    """The camera of recordings or of the recordings of result folders, all of one camera.

    truth: the recordings' true poses tell the scale of depth. Raises RecordingError if the recordings show too little, or, with `truth`,
    have no true poses; ConfigError if their cameras differ.
    """
    if not sources:
        raise ConfigError("no recordings, expected at least one, or a result folder of `run`")
    recordings = [_recording_of(source) for source in sources]
    _check_one_camera(recordings)
    if truth and all(recording.ground_truth is None for recording in recordings):
        raise RecordingError(f"{recordings[0].name}: no true poses, which --truth takes the scale of depth from: leave it out")
    pairs = zip(sources, recordings, strict=True)
    return calibrate_from([found for pair in pairs for found in keyframes_of(*pair, config, console)], truth=truth, console=console)


def calibrate_from(maps: Sequence[Keyframes], *, truth: bool, console: Console | None = None) -> Calibrated:
    """The same from keyframes."""
    first = maps[0].recording
    _check_one_camera([found.recording for found in maps])
    maps = _thinned(maps)
    if console is not None:
        count = sum(len(found.views) for found in maps)
        console.print(f"adjusting {count} keyframes, their landmarks and the camera together", highlight=False)
    estimate = self_calibrate([Footage(found.views, found.poses, found.motions) for found in maps])
    if estimate is None:
        found = f"{sum(len(found.views) for found in maps)} keyframes with too few landmarks in common"
        raise RecordingError(f"{first.name}: {found}, expected several views of one place: record a textured room from many sides")
    if truth:
        true = [np.full((len(m.views), 4, 4), np.nan) if (T := m.recording.ground_truth) is None else T[m.indices] for m in maps]
        scaled = with_scale(estimate, true)
        if scaled is None:
            raise RecordingError(
                f"{first.name}: no true poses of a moving camera, which --truth takes the scale of depth from: leave it out"
            )
        estimate = scaled
    of_each = {id(found.recording): found.times for found in maps}  # its submaps share them
    return Calibrated(replace(estimate, model=of_size(estimate.model, first.camera)), first, mean_times(list(of_each.values())))


def unexplained(estimate: Estimate) -> str:
    """What to say of an estimate that does not explain the images."""
    found = f"no camera explains the images to better than {estimate.noise:.2f} px of 640, expected {EXPLAINED}"
    return f"{found}: blur or a shutter bends them, or objects move; record a still scene slowly"


def calibrated(source: RecordingSource, config: Config, path: Path, console: Console | None) -> RecordingSource:
    """The recording of `source` with the camera that it shows itself, which is written to a file `path`.

    If it shows too little, a warning says so, and it stays as it was. A guessed camera is replaced also by one that fits only roughly.
    """
    try:
        estimate, recording, _ = calibrate([source], config, truth=False, console=console)  # the run estimates the times by itself
    except RecordingError as error:
        log.warning("%s; the camera stays as it is stated", error)
        return source
    if not estimate.explains_images and is_guessed(recording):
        log.warning("%s; the camera is only known roughly", unexplained(estimate))
    elif not estimate.explains_images:
        log.warning("%s; the camera stays as it is stated", unexplained(estimate))
        return source
    write_camera(path, estimate, recording)
    for finding in findings(estimate):
        log.info("%s: %s", finding.name, finding.found)
    times = {name: value for name, value in (source.camera or {}).items() if name in TIMES}
    return replace(source, camera=times or None, depth_scale=None, camera_file=str(path.absolute()))


def _run_of(source: RecordingSource) -> FinishedRun | None:
    """The run, if the source is a result folder."""
    folder = Path(source.path)
    is_run = (folder / result_folder.KEYFRAMES).is_file() and (folder / result_folder.CONFIG).is_file()
    return FinishedRun(folder) if is_run else None


def _recording_of(source: RecordingSource) -> Dataset:
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


def rectified_keyframe(run: FinishedRun, frame: Frame, times: Mapping[str, SensorTime]) -> tuple[View, KeyframeMotion]:
    """A frame of a run as a synchronised global shutter would have seen it, and how the camera moved, by the poses and times of the run."""
    rows = row_times(frame, times)
    if rows.synchronised:
        return View.of(frame), unknown_motion(rows)
    around = stretch_around(run.trusted, frame.index, STAMPS)
    stamps, poses = run.trajectory.timestamps, run.trajectory.poses
    found = motion_around(stamps[frame.index], stamps[around], poses[around], rows)
    if found is None:
        return View.of(frame), unknown_motion(rows)
    rectification = Rectification(rows, found.velocity)
    return View.of(rectified(frame, rectification)), replace(found, rectification=rectification)


def row_times(frame: Frame, found: Mapping[str, SensorTime]) -> RowTimes:
    """The times of a frame's rows: those that it states, those that were found for sure, or zero."""
    sure = {name: time.value for name, time in found.items() if time.is_sure}
    known = {name: sure.get(name, 0.0) if stated is None else stated for name, stated in vars(frame.timing).items()}
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
    stored = slam.graph.keyframes
    if not stored:
        raise RecordingError(f"{recording.name}: none of {done} frames has depth, so there is nothing to calibrate")
    groups = [[keyframe for keyframe in stored if keyframe.submap == submap] for submap in sorted({k.submap for k in stored})]
    times, motions = _times(slam.figures()), KeyframeMotions(slam.frames, slam.front_end.row_times)
    return [_keyframes(recording, group, motions, times) for group in groups]


def _keyframes(recording: Dataset, group: Sequence[Keyframe], motions: KeyframeMotions, times: Mapping[str, SensorTime]) -> Keyframes:
    indices, poses = np.array([k.index for k in group]), np.array([k.T_wk.numpy() for k in group])
    return Keyframes(recording, indices, [View.of(k.frame) for k in group], poses, [motions.of(k) for k in group], times)


def _times(figures: Mapping[str, Any]) -> dict[str, SensorTime]:
    """The times of the sensor in the figures of a run; empty if none are unknown, or if nothing moved."""
    return {name: SensorTime(*found) for name, found in (figures.get("sensor_timing_estimates") or {}).items()}


def _check_one_camera(recordings: Sequence[Dataset]) -> None:
    for other in recordings[1:]:
        if (other.camera, _sources(other)) != (recordings[0].camera, _sources(recordings[0])):
            found = f"the cameras of {recordings[0].name} and {other.name} are stated differently"
            raise ConfigError(f"{found}, expected recordings of one camera: calibrate each by itself")


def _sources(recording: Dataset) -> tuple[float, tuple[float, ...]]:
    stated = provenance(recording) or Provenance("")
    return stated.depth_scale, stated.distortion


def _thinned(maps: Sequence[Keyframes]) -> list[Keyframes]:
    total = sum(len(found.views) for found in maps)
    if total <= _MOST_KEYFRAMES:
        return list(maps)
    chosen = np.zeros(total, bool)
    chosen[np.linspace(0, total - 1, _MOST_KEYFRAMES).round().astype(int)] = True
    parts = np.split(chosen, np.cumsum([len(found.views) for found in maps])[:-1])
    return [found[part] for found, part in zip(maps, parts) if part.any()]


def check_camera_path(path: Path) -> None:
    """Raises ConfigError for a path at which no camera file can be written, or from which none would be read as JSON."""
    if path.suffix != ".json":
        raise ConfigError(f"--out {path}: expected the name of a file that ends with .json, such as camera.json")
    parent = next(folder for folder in (path.parent, *path.parent.parents) if folder.exists())
    if path.is_dir():
        raise ConfigError(f"--out {path}: is a folder, expected the name of a file")
    if not parent.is_dir():
        raise ConfigError(f"--out {path}: {parent} is a file, expected a folder: choose another name")


def write_camera(path: Path, estimate: Estimate, recording: Dataset, times: Mapping[str, SensorTime] = MappingProxyType({})) -> None:
    """Writes the camera file of a recording that was read as `recording` and calibrated. Stated values that fit stay, guesses do not.

    times: of the sensor, by name; those that differ from zero for sure are written.
    """
    model = estimate.model if is_guessed(recording) else confirmed(estimate)
    values = camera_values(model, recording.camera, provenance(recording) or Provenance(""))
    values |= {name: round(time.value, 5) for name, time in times.items() if time.is_sure and (time.value > 0 or name == "depth_delay")}
    with result_folder.writing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_files.write_json(path, {"camera": values})


def camera_values(model: CameraModel, read_as: Camera, stated: Provenance) -> dict[str, Any]:
    """`camera` of cam_params.json for the images as they are stored, which are read as `read_as` with what is `stated` taken out."""
    camera, lens = in_a_row(stated.distortion, read_as, model)
    size = stated.size or (camera.width, camera.height)
    c = camera.resized(*size)
    values: dict[str, Any] = {"w": c.width, "h": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy}
    values["scale"] = stated.depth_scale / model.depth_factor
    both = zip(*(vars(each).values() for each in (stated.deformation or DepthDeformation(), model.deformation)))
    deformation = DepthDeformation(*(a + b for a, b in both))
    return values | ({"distortion": list(lens)} if any(lens) else {}) | ({DEFORMATION: vars(deformation)} if deformation else {})


def in_a_row(distortion: Sequence[float], read_as: Camera, model: CameraModel) -> tuple[Camera, tuple[float, ...]]:
    """The camera and lens (OpenCV's k1 k2 p1 p2 k3 ...) of images that were undistorted to `read_as` and then found to be of `model`."""
    if not any(distortion):
        return model.camera, ((*model.distortion, 0.0, 0.0) if any(model.distortion) else ())
    import cv2

    x, y = np.meshgrid(*(np.linspace(-0.5, n - 0.5, _GRID) for n in (read_as.width, read_as.height)))
    rays = model.rays(np.stack([x.ravel(), y.ravel()], 1))
    uv = model.project(rays)[0]
    before = np.concatenate([(uv - [read_as.cx, read_as.cy]) / [read_as.fx, read_as.fy], np.ones((len(uv), 1))], 1)
    origin = np.zeros(3)
    raw = cv2.projectPoints(before, origin, origin, read_as.matrix().numpy(), np.array(distortion))[0][:, 0]

    def off(p: NDArray[np.float64]) -> NDArray[np.float64]:
        K = np.array([[p[0], 0, p[2]], [0, p[1], p[3]], [0, 0, 1]])
        return np.asarray(cv2.projectPoints(rays, origin, origin, K, p[4:])[0][:, 0] - raw, np.float64).ravel()

    c, lens = model.camera, [*distortion, *[0.0] * (5 - len(distortion))]
    fit = least_squares(off, [c.fx, c.fy, c.cx, c.cy, *lens], x_scale=[c.fx, c.fx, c.fx, c.fx, *[0.1] * len(lens)]).x.tolist()
    return Camera(c.width, c.height, *fit[:4]), tuple(fit[4:])
