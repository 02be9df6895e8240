"""Evaluates a result folder against the ground truth of its recording, or against ground truth in files."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from idfslam.datasets import Dataset
from idfslam.errors import IdfSlamError, ResultError
from idfslam.evaluation.depth_range import DepthRange, depth_range
from idfslam.evaluation.evaluate import evaluate, load_mesh
from idfslam.evaluation.evaluation import Evaluation
from idfslam.evaluation.mesh_error import SAMPLES, VIEWS
from idfslam.evaluation.protocols import find_protocol
from idfslam.evaluation.truth_file import read_truth
from idfslam.geometry.trajectory import Trajectory
from idfslam.live import is_live, replayed_path
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.keyframes_file import read_keyframes
from idfslam.runs.run_config import read_config
from idfslam.runs.source import open_source
from idfslam.storage import output_folder

_PROTOCOL = "seen"

log = logging.getLogger(__name__)


def evaluate_folder(
    folder: Path,
    *,
    gt: Path | None = None,
    gt_mesh: Path | None = None,
    protocol: str | None = None,
    recording: Dataset | None = None,
    samples: int = SAMPLES,
    views: int = VIEWS,
) -> Evaluation:
    """Measures the errors of the results in `folder`, and writes evaluation.json, trajectory.png and error.png there.

    gt: file of the true trajectory, see `read_truth`; None: the recording's own. gt_mesh: true mesh [m] in the frame of the true
    trajectory; None: the surface of a generated recording if `gt` is None too, else the mesh is not evaluated.
    protocol: of the mesh; None: `seen`. One that is named without a true mesh is a warning.
    recording: the recording of the run, if it is already open; None: the one in config.yaml is opened.
    samples: points on each surface. views: for depth L1.
    Raises ResultError if results or ground truth are missing, RecordingError if the recording is missing and `gt` is not given.
    """
    run = FinishedRun(folder)
    rules = find_protocol(protocol or _PROTOCOL)
    if recording is None and gt is None:
        recording = _recording(folder)
    trajectory = _recorded_truth(folder, recording) if gt is None else read_truth(gt, run.trajectory)
    surface = load_mesh(gt_mesh) if gt_mesh is not None else recording.surface() if recording is not None and gt is None else None
    if surface is None and protocol is not None:
        log.warning(
            "%s: --protocol %s needs a true mesh, and there is none: give --gt-mesh; only the poses are evaluated", folder, protocol
        )
    record = read_keyframes(folder)
    with output_folder.locked(folder):
        result_folder.ledger(folder)
        return evaluate(
            folder,
            gt_trajectory=trajectory,
            gt_mesh=surface,
            camera=record.camera,
            sensor_range=_readings(folder, recording) if surface is not None and rules.sensor_limited else None,
            protocol=rules.name,
            keyframes=np.flatnonzero(np.isin(run.listed, record.indices)),
            measured=run.measured[run.listed] if run.frames is not None else None,
            reported=run.reported,
            samples=samples,
            views=views,
        )


def _recording(folder: Path) -> Dataset | None:
    """The recording of the run; None if the frames came from a camera or from a program."""
    _, source = read_config(folder)
    if source is not None and is_live(source.path):
        path = replayed_path(source.path)
        source = None if path is None else replace(source, path=path, frames=None)
    return None if source is None else open_source(replace(source, truth=True))  # also where the run left it unread


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
