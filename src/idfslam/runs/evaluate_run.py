"""Evaluates a result folder against the ground truth of its recording, or against ground truth in files."""

import logging
from dataclasses import replace
from pathlib import Path

from idfslam.datasets import Dataset
from idfslam.errors import IdfSlamError, ResultError
from idfslam.evaluation.depth_range import DepthRange, depth_range
from idfslam.evaluation.evaluate import evaluate, load_mesh
from idfslam.evaluation.evaluation import Evaluation
from idfslam.evaluation.mesh_error import SAMPLES, VIEWS, find_protocol
from idfslam.geometry.trajectory import Trajectory, load_tum
from idfslam.live import is_live, replayed_path
from idfslam.runs import result_folder
from idfslam.runs.source import open_source
from idfslam.storage import output_folder

log = logging.getLogger(__name__)


def evaluate_folder(
    folder: Path,
    *,
    gt: Path | None = None,
    gt_mesh: Path | None = None,
    protocol: str = "seen",
    recording: Dataset | None = None,
    samples: int = SAMPLES,
    views: int = VIEWS,
) -> Evaluation:
    """Measures the errors of the results in `folder`, and writes evaluation.json, trajectory.png and error.png there.

    gt: true trajectory in TUM format, matched by time stamp; None: the recording's own. gt_mesh: true mesh [m] in the frame of the true
    trajectory; None: the surface of a generated recording if `gt` is None too, else the mesh is not evaluated.
    recording: the recording of the run, if it is already open; None: the one in config.yaml is opened.
    samples: points on each surface. views: for depth L1.
    Raises ResultError if results or ground truth are missing, RecordingError if the recording is missing and `gt` is not given.
    """
    result_folder.existing(folder, result_folder.TRAJECTORY)
    rules = find_protocol(protocol)
    if recording is None and gt is None:
        recording = _recording(folder)
    trajectory = _recorded_truth(folder, recording) if gt is None else load_tum(gt)
    surface = load_mesh(gt_mesh) if gt_mesh is not None else recording.surface() if recording is not None and gt is None else None
    record = result_folder.read_keyframes(folder)
    with output_folder.locked(folder):
        result_folder.ledger(folder)
        return evaluate(
            folder,
            gt_trajectory=trajectory,
            gt_mesh=surface,
            camera=record.camera,
            sensor_range=_readings(folder, recording) if surface is not None and rules.sensor_limited else None,
            protocol=protocol,
            keyframes=record.indices,
            samples=samples,
            views=views,
        )


def _recording(folder: Path) -> Dataset | None:
    """The recording of the run; None if the frames came from a camera or from a program."""
    _, source = result_folder.read_config(folder)
    if source is not None and is_live(source.path):
        path = replayed_path(source.path)
        source = None if path is None else replace(source, path=path, frames=None)
    return None if source is None else open_source(source)


def _recorded_truth(folder: Path, recording: Dataset | None) -> Trajectory:
    if recording is None or recording.ground_truth is None:
        raise ResultError(f"{folder}: its recording has no ground truth; give one with --gt (TUM format: t tx ty tz qx qy qz qw)")
    return Trajectory.of_known(recording.timestamps, recording.ground_truth)


def _readings(folder: Path, recording: Dataset | None) -> DepthRange | None:
    """The range of the recording's depths; None, with a warning, if it cannot be read."""
    why = ""
    try:
        recording = _recording(folder) if recording is None else recording
    except IdfSlamError as error:
        why = f" ({error})"
    readings = None if recording is None else depth_range(recording)
    if readings is None:
        log.warning("%s: no depth image of its recording can be read%s; all surface in view up to 10 m counts as seen", folder, why)
    return readings
