"""Calibrates the camera of recordings from their keyframes."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from idfslam.adjustment.camera_findings import findings
from idfslam.adjustment.self_calibration import EXPLAINED, CameraEstimate, PosedViews, of_size, self_calibrate, with_scale
from idfslam.adjustment.sensor_times import SensorTime, mean_times
from idfslam.config import Config
from idfslam.datasets import Dataset
from idfslam.datasets.cameras.calibration import TIMES
from idfslam.datasets.provenance import Provenance, is_guessed, provenance
from idfslam.errors import ConfigError, RecordingError
from idfslam.geometry.even_spacing import evenly_spread
from idfslam.runs.calibrated_camera import write_camera
from idfslam.runs.calibration_keyframes import Keyframes, keyframes_of, recording_of
from idfslam.runs.run_config import RecordingSource

log = logging.getLogger(__name__)

_MOST_KEYFRAMES = 120  # in all, evenly spread; more: slower, and more exact where a recording shows more. Chosen by hand


class Calibrated(NamedTuple):
    """The camera of recordings."""

    estimate: CameraEstimate
    recording: Dataset  # the first one, as it was read
    times: Mapping[str, SensorTime]  # of the sensor, by name: those that the recordings do not state


def calibrate(sources: Sequence[RecordingSource], config: Config, *, truth: bool, console: Console | None = None) -> Calibrated:
    """The camera of recordings or of the recordings of result folders, all of one camera.

    truth: the recordings' true poses tell the scale of depth. Raises RecordingError if the recordings show too little, or, with `truth`,
    have no true poses; ConfigError if their cameras differ.
    """
    if not sources:
        raise ConfigError("no recordings, expected at least one, or a result folder of `run`")
    recordings = [recording_of(source) for source in sources]
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
    estimate = self_calibrate([PosedViews(found.views, found.poses, found.motions, found.time_sigmas) for found in maps])
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


def unexplained(estimate: CameraEstimate) -> str:
    """What to say of an estimate that does not explain the images."""
    found = f"no camera explains the images to better than {estimate.noise:.2f} px of 640, expected {EXPLAINED}"
    return f"{found}: blur or a shutter bends them, or objects move; record a still scene slowly"


def with_own_camera(source: RecordingSource, config: Config, path: Path, console: Console | None) -> RecordingSource:
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
    chosen[evenly_spread(total, _MOST_KEYFRAMES)] = True
    parts = np.split(chosen, np.cumsum([len(found.views) for found in maps])[:-1])
    return [found[part] for found, part in zip(maps, parts) if part.any()]
