"""Runs SLAM on a recording or a live camera and writes the result folder."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import Any

import trimesh
from rich.console import Console

from idfslam.compute.devices import resolve_device
from idfslam.compute.interrupt import stop_on_interrupt
from idfslam.config import Config
from idfslam.datasets import Dataset
from idfslam.errors import DivergedError, FrameError, RecordingError, ResultError
from idfslam.frame import Frame
from idfslam.geometry.trajectory import Trajectory
from idfslam.live import LiveStream, is_live
from idfslam.runs import result_folder, run_folder
from idfslam.runs.checkpoint import Checkpoints, fingerprint
from idfslam.runs.compile_ahead import compiling_ahead
from idfslam.runs.metrics import kept_keyframes, keyframe_counts, run_metrics
from idfslam.runs.prior_map import PriorMap
from idfslam.runs.progress import ProgressBar
from idfslam.runs.result_writer import ResultWriter, trajectory_of
from idfslam.runs.run_config import RecordingSource, read_config, write_config
from idfslam.runs.run_folder import RunFolder
from idfslam.runs.run_state import RunState
from idfslam.runs.source import open_source, read_frames
from idfslam.slam import Slam
from idfslam.slam.warm_up import COMPILING, warm_up, will_compile
from idfslam.viewer.viewer import NO_VIEWER, Viewer

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class RunResult:
    """The results of a run."""

    folder: Path
    trajectory: Trajectory  # one pose for every frame processed
    mesh: trimesh.Trimesh
    metrics: dict[str, Any]  # the values of metrics.json


def run(
    recording: Dataset | LiveStream,
    config: Config,
    folder: Path,
    *,
    source: RecordingSource | None = None,
    prior: PriorMap | None = None,
    console: Console | None = None,
    make_slam: Callable[[Config], Slam] = Slam,
    checkpoint_every: int = 0,
    resume: bool = False,
    overwrite: bool = False,
    viewer: Viewer = NO_VIEWER,
) -> RunResult:
    """Runs SLAM on a recording or a live camera, writes the results to `folder` and shows them in `viewer`.

    Every frame of a recording is processed; of a live camera, always the newest one.
    source: how the recording was opened, for config.yaml. prior: a saved map to start in. console: where progress is shown.
    checkpoint_every: frames between checkpoints; 0: none. resume: continue from the checkpoint in `folder`, or from the first frame if
    there is none. Checkpoints exist for recordings only, and only without `prior`. overwrite: results in `folder` are replaced once those
    of this run are complete; until then they stay.

    The first Ctrl-C ends the run after the current frame, with a checkpoint and all results so far; a second one ends it at once. An
    unreadable frame is reported and counts as lost. The number of torch's threads is left as it is.

    Raises, before the first frame, ResultError if the folder cannot be written to, is in use, holds results (without `overwrite`) or
    anything else than results, or if its checkpoint is of another run; later ResultError if a file cannot be written, CameraError if a
    camera gives no frame, and, after the poses so far are written, DivergedError for a loss that is not finite and RecordingError if no
    frame has depth or the recording disappears.
    """
    with run_folder.claimed(folder, overwrite=overwrite, resume=resume, writes=viewer.files) as place:
        state = RunState(_new_slam(recording, config, prior, make_slam, console, place.partial))
        writer = ResultWriter(place.partial, state.slam, recording, config, source=source, prior=prior)
        checkpoints = _checkpoints(recording, config, folder, prior, checkpoint_every)
        with (
            viewer.opened(place.partial, recording.name),
            checkpoints,
            stop_on_interrupt() as stop,
            ProgressBar(None if isinstance(recording, LiveStream) else len(recording), console) as bar,
        ):
            if resume:
                _restore(state, checkpoints, recording, bar)
            elif checkpoints.enabled and source is not None:
                with result_folder.writing(folder):
                    write_config(place.partial, config, source)
            try:
                _process(state, recording, source, viewer, checkpoints, stop, bar)
            except (DivergedError, RecordingError):
                _write_poses(writer, state, place)
                raise
            metrics = run_metrics(state.slam, recording, state.meter, state.frame_log, interrupted=stop.is_set())
            metrics |= _camera_metrics(recording)
            bar.finish(keyframes=metrics["keyframes"], lost=metrics["lost_frames"], doubtful=metrics["doubtful_frames"])
            bar.describe("writing the mesh and the map")
            mesh = state.slam.mesh(config.mesh.resolution)
            viewer.finish(state.slam, mesh)
            with result_folder.writing(folder):
                writer.write_all(mesh, state.frame_log, metrics)
        with result_folder.writing(folder):
            place.swap()
        if not stop.is_set():
            checkpoints.remove()
    return RunResult(folder, trajectory_of(state.slam, recording), mesh, metrics)


def resume(folder: Path, *, checkpoint_every: int = 0, console: Console | None = None, viewer: Viewer = NO_VIEWER) -> RunResult | None:
    """Continues the interrupted run of a result folder, with the values in its config.yaml; None if that run is complete.

    The results are those of a run without the interruption. Raises ResultError for a folder without a run of a recording, and what `run`
    raises.
    """
    config, source = read_config(run_folder.config_folder(folder))
    if source is None:
        raise ResultError(f"{folder / result_folder.CONFIG}: names no recording, so the run cannot be resumed; start a new one")
    if not run_folder.is_unfinished(folder):
        return None
    if is_live(source.path):
        raise ResultError(f"{folder}: is a run of a live camera ({source.path}), which cannot be resumed; start a new one")
    shown: dict[str, Any] = {"console": console, "viewer": viewer}
    recording = open_source(source, report=True)
    return run(recording, config, folder, source=source, checkpoint_every=checkpoint_every, resume=True, **shown)


def _new_slam(
    recording: Dataset | LiveStream,
    config: Config,
    prior: PriorMap | None,
    make_slam: Callable[[Config], Slam],
    console: Console | None,
    partial: Path,
) -> Slam:
    """The SLAM system, in the prior map if there is one. Kernels are compiled before the first frame, and for a live camera loaded too.

    partial: the folder for the images that are not kept in memory.
    """
    if console is not None and will_compile(config):
        console.print(COMPILING, highlight=False, soft_wrap=True)
    with compiling_ahead(config):
        pass  # until all is compiled: a process that compiles is not repeatable
    if isinstance(recording, LiveStream):
        if console is not None:
            console.print("getting ready: hold the camera still until frames are counted", highlight=False, soft_wrap=True)
        warm_up(config, make_slam)
    slam = make_slam(config if prior is None else replace(config, field=prior.saved.field.config))  # the saved field keeps its own shape
    slam.swap_to(partial)
    if prior is not None:
        slam.start_in(prior.saved, [(keyframe.frame, keyframe.T_wk) for keyframe in prior.keyframes], prior.archive)
    return slam


def _checkpoints(recording: Dataset | LiveStream, config: Config, folder: Path, prior: PriorMap | None, every: int) -> Checkpoints:
    if isinstance(recording, LiveStream) or prior is not None:
        return Checkpoints(folder, None)
    return Checkpoints(folder, fingerprint(config, recording, resolve_device(config.device, config.preset)), every=every)


def _process(
    state: RunState,
    recording: Dataset | LiveStream,
    source: RecordingSource | None,
    viewer: Viewer,
    checkpoints: Checkpoints,
    stop: Event,
    bar: ProgressBar,
) -> None:
    """All frames from the state's next one on, with checkpoints, and the last refinement."""
    for frame, readable in read_frames(recording, source, first=state.meter.frames):
        result = state.process(frame, readable=readable, viewer=viewer)
        kept = kept_keyframes(state.slam) if result.keyframe else None
        bar.update(result, frames_per_second=state.meter.frames_per_second, keyframes=kept)
        if checkpoints.due(state.meter.frames, stopping=stop.is_set()):
            checkpoints.save(state.meter.frames, state.state())
        if stop.is_set():
            log.warning("interrupted after frame %d: writing the results so far", frame.index)
            break
    bar.describe("refining keyframes and map")
    _finish(state.slam, recording)


def _write_poses(writer: ResultWriter, state: RunState, place: RunFolder) -> None:
    """The poses so far of a run that failed. Without any keyframe they mean nothing, and nothing is kept."""
    if state.slam.stored_keyframes():
        with result_folder.writing(place.path):
            writer.write_poses()
            writer.write_frames(state.frame_log)
    else:
        place.discard()


def _restore(state: RunState, checkpoints: Checkpoints, recording: Dataset | LiveStream, bar: ProgressBar) -> None:
    """Sets the state of the last checkpoint; without one the run starts at the first frame."""
    stored = checkpoints.read()
    if stored is None or isinstance(recording, LiveStream):
        return

    def frame(i: int) -> Frame:
        try:
            return recording[i]
        except FrameError as error:
            raise RecordingError(f"{error}; the run cannot be resumed without this frame, because it is a keyframe") from error

    state.restore(stored, frame)
    counts = keyframe_counts(state.slam)
    found = {"keyframes": counts["keyframes"], "lost": counts["lost_frames"], "doubtful": counts["doubtful_frames"]}
    bar.resume(done=state.meter.frames, **found)


def _finish(slam: Slam, recording: Dataset | LiveStream) -> None:
    """The last refinement. Raises RecordingError if there is nothing to refine."""
    if not slam.stored_keyframes():
        raise RecordingError(f"{recording.name}: none of {len(slam.statuses())} frames has depth, so there is nothing to map")
    slam.finish()


def _camera_metrics(recording: Dataset | LiveStream) -> dict[str, Any]:
    """What a live camera adds to metrics.json."""
    if isinstance(recording, LiveStream):
        return {"dropped_frames": recording.dropped, "camera_lost": recording.failure is not None}
    return {}
