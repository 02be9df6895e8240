"""A recording through Slam into a result folder."""

import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from rich.console import Console

from idfslam.compute.devices import resolve_device
from idfslam.compute.interrupt import stop_on_interrupt
from idfslam.config import Config
from idfslam.datasets import Dataset, FrameSource, Prefetch
from idfslam.errors import DivergedError, FrameError, RecordingError, ResultError
from idfslam.evaluation.evaluate import evaluate_poses
from idfslam.evaluation.summary import Evaluation, plot_trajectory
from idfslam.frame import Frame, FrameResult, Status
from idfslam.geometry.trajectory import Trajectory, save_tum
from idfslam.live import LiveStream, is_live
from idfslam.runs import result_folder
from idfslam.runs.checkpoint import Checkpoints, made_of
from idfslam.runs.frame_log import FrameLog
from idfslam.runs.metrics import Meter
from idfslam.runs.prior_map import PriorMap
from idfslam.runs.progress import ProgressBar
from idfslam.runs.source import open_source
from idfslam.slam import Slam
from idfslam.slam.warm_up import warm_up
from idfslam.storage import atomic_files
from idfslam.viewer.rerun_viewer import NullViewer, Viewer

log = logging.getLogger(__name__)

_NOTHING = NullViewer()


@dataclass(frozen=True, eq=False)
class Run:
    """What a run left behind."""

    folder: Path
    trajectory: Trajectory  # one pose for every frame processed
    mesh: trimesh.Trimesh
    metrics: dict[str, Any]  # what metrics.json holds


def run(
    recording: Dataset | LiveStream,
    config: Config,
    folder: Path,
    *,
    source: result_folder.Source | None = None,
    prior: PriorMap | None = None,
    console: Console | None = None,
    make_slam: Callable[[Config], Slam] = Slam,
    checkpoint_every: int = 0,
    resume: bool = False,
    viewer: Viewer = _NOTHING,
) -> Run:
    """Every frame of `recording`, or of a live camera those that there is time for, through Slam; all results into `folder`, and before
    the eyes of `viewer`.

    Ctrl-C ends after the frame in hand and writes the results so far; a second one ends at once. A frame that cannot be read is
    reported and treated as lost. Every `checkpoint_every` frames (0: never), and on Ctrl-C, the state is kept; with `resume` the run goes
    on from the last that was, or from its beginning; of a recording alone, and without `prior`. Raises ResultError before anything is
    computed if the folder cannot be written to or its checkpoint is of another run, later where files cannot be written, and after the
    poses so far are written DivergedError, or RecordingError if no frame could be used or the recording is gone; CameraError if none came.
    """
    atomic_files.prepare(folder)
    if config.field.encoding == "grid":
        torch.set_num_threads(1)  # its tensors are small and Numba uses the cores: threads that wait for each other cost half the rate
    if isinstance(recording, LiveStream):
        if console is not None:
            console.print("getting ready: hold the camera still until frames are counted", highlight=False, soft_wrap=True)
        warm_up(config, make_slam)
    slam = make_slam(config) if prior is None else started_in(prior, config, make_slam)
    meter, frame_log = Meter(), FrameLog()
    device = resolve_device(config.device, config.preset)
    made = None if isinstance(recording, LiveStream) or prior is not None else made_of(config, recording, device)
    checkpoints = Checkpoints(folder, made or {})
    with (
        viewer.opened(folder, recording.name),
        checkpoints,
        stop_on_interrupt() as stop,
        ProgressBar(None if isinstance(recording, LiveStream) else len(recording), console) as bar,
    ):
        if resume:
            _restore(checkpoints, slam, recording, meter, frame_log, bar)
        else:
            _begin(folder, config, source if made else None, viewer.files)

        def keep() -> None:
            if made and checkpoint_every and (stop.is_set() or meter.frames % checkpoint_every == 0):
                checkpoints.keep(meter.frames, {"meter": meter.state(), "frame_log": frame_log.state(), "slam": slam.state()})

        try:
            _process(slam, frames(recording, meter.frames, source), meter, frame_log, bar, stop, keep, viewer)
            bar.describe("refining")
            if not slam.graph.keyframes:
                raise RecordingError(f"{recording.name}: none of {len(slam.statuses())} frames has depth, so there is nothing to map")
            slam.finish()
        except (DivergedError, RecordingError):
            written = _write_poses(folder, slam, recording, config, source, prior) | _write_log(folder, frame_log, slam)
            result_folder.remove_stale(folder, written=written | viewer.files)
            raise
        metrics = _metrics(slam, recording, meter, stop)
        bar.describe("writing")
        mesh = slam.mesh(config.mesh.resolution)
        viewer.finish(slam, mesh)
        with result_folder.writing(folder):
            written = _write_poses(folder, slam, recording, config, source, prior) | _write_map(folder, slam, mesh)
            written |= _write_log(folder, frame_log, slam) | viewer.files
            atomic_files.write_json(folder / result_folder.METRICS, metrics)
            result_folder.remove_stale(folder, written=written | {result_folder.METRICS})
        if not stop.is_set():
            checkpoints.remove()
    return Run(folder, _trajectory(slam, recording), mesh, metrics)


def _metrics(slam: Slam, recording: Dataset | LiveStream, meter: Meter, stop: threading.Event) -> dict[str, Any]:
    """What metrics.json tells."""
    metrics = meter.summary(slam.timings) | {"interrupted": stop.is_set()}
    if isinstance(recording, LiveStream):
        metrics |= {"dropped_frames": recording.dropped, "camera_lost": recording.failure is not None}
    errors = evaluation(slam, recording)
    metrics |= counts(slam) | ({} if errors is None else errors.to_dict())
    if (told := evaluation(slam, recording, live=True)) is not None and told.ate is not None:
        metrics["live_ate_m"] = told.ate.translation.rmse
    return metrics


def started_in(prior: PriorMap, config: Config, make_slam: Callable[[Config], Slam] = Slam) -> Slam:
    """A system whose map is an earlier run's; the field is as it was there, whatever the config says."""
    slam = make_slam(replace(config, field=prior.saved.field.config))
    slam.start_in(prior.saved, [(keyframe.frame, keyframe.T_wk) for keyframe in prior.keyframes])
    return slam


def resume(folder: Path, *, checkpoint_every: int = 0, console: Console | None = None) -> Run | None:
    """Goes on with the run of a folder by its config.yaml, to the same results as without a break; None where that run is over.

    Raises ResultError for a folder without a run, and as `run` does.
    """
    config, source = result_folder.read_config(folder)
    if source is None:
        raise ResultError(f"{folder / result_folder.CONFIG}: names no recording, expected that of a run; start the run anew")
    if (folder / result_folder.METRICS).exists() and not (folder / result_folder.CHECKPOINT).exists():
        return None
    if is_live(source.path):
        raise ResultError(f"{folder}: is of a live camera ({source.path}), which cannot be gone on with; start a new run")
    return run(open_source(source), config, folder, source=source, console=console, checkpoint_every=checkpoint_every, resume=True)


def frames(recording: Dataset | LiveStream, first: int = 0, source: result_folder.Source | None = None) -> Iterator[tuple[Frame, bool]]:
    """Each frame from `first` on, read ahead, and whether it could be read; a blank one stands for one that could not.

    Raises RecordingError where the source as a whole is there no more.
    """
    for i, frame in recording if isinstance(recording, LiveStream) else Prefetch(recording, first=first):
        if isinstance(frame, Frame):
            yield frame, True
        elif source is not None and Path(source.path).is_absolute() and not Path(source.path).exists():
            raise RecordingError(f"{source.path}: is gone since frame {i}; bring it back, then `idf-slam run --resume` goes on")
        else:
            log.warning("%s; the frame is treated as lost", frame)
            yield Frame.blank(i, float(recording.timestamps[i]), recording.camera), False


def _begin(folder: Path, config: Config, source: result_folder.Source | None, keep: frozenset[str]) -> None:
    """Makes way for a new run; where it has a source that can be gone on with, its config stands there from now on."""
    if (folder / result_folder.CHECKPOINT).exists():
        log.warning("%s: held a run that was not over, which --resume would have gone on with; a new one takes its place", folder)
    (folder / result_folder.CHECKPOINT).unlink(missing_ok=True)
    if source is not None:  # a camera may yet give nothing, and then an earlier run's files stay
        result_folder.remove_stale(folder, written={*keep})
        with result_folder.writing(folder):
            result_folder.write_config(folder, config, source)


def _restore(
    checkpoints: Checkpoints, slam: Slam, recording: Dataset | LiveStream, meter: Meter, frame_log: FrameLog, bar: ProgressBar
) -> None:
    """Everything as it was at the last checkpoint; at a run's beginning where it had none."""
    state = checkpoints.read()
    if state is None or isinstance(recording, LiveStream):
        return

    def frame(i: int) -> Frame:
        try:
            return recording[i]
        except FrameError as error:
            raise RecordingError(f"{error}; the run cannot go on without it, since it is a keyframe") from error

    slam.restore(state["slam"], frame)
    meter.restore(state["meter"])
    frame_log.restore(state["frame_log"])
    found = counts(slam)
    bar.resume(done=meter.frames, keyframes=found["keyframes"], lost=found["lost_frames"])


def _process(
    slam: Slam,
    incoming: Iterator[tuple[Frame, bool]],
    meter: Meter,
    frame_log: FrameLog,
    bar: ProgressBar,
    stop: threading.Event,
    keep: Callable[[], None],
    viewer: Viewer,
) -> None:
    """Frames through Slam until the end or the first Ctrl-C; `keep` is called after each."""
    for frame, readable in incoming:
        result: FrameResult = slam.process(frame)
        viewer.frame(frame, result, slam)
        frame_log.add(result, meter.frame(readable=readable))
        bar.update(result, frames_per_second=meter.frames_per_second)
        keep()
        if stop.is_set():
            log.warning("interrupted after frame %d: writing the results so far", frame.index)
            break


def counts(slam: Slam) -> dict[str, Any]:
    """The keyframes and what connects them, and how many frames are lost (with those whose pose was filled in later) or degenerate."""
    found = Counter(slam.statuses())
    frames = {
        "lost_frames": found[Status.LOST] + found[Status.INTERPOLATED],
        "interpolated_frames": found[Status.INTERPOLATED],
        "degenerate_frames": found[Status.DEGENERATE],
    }
    return {"keyframes": len(slam.graph.first_submap)} | frames | slam.figures()


def evaluation(slam: Slam, recording: FrameSource, *, live: bool = False) -> Evaluation | None:
    """ATE and RPE where the recording has ground truth, None where it has none; live: of the poses as they were first told."""
    poses = slam.live_trajectory() if live else slam.trajectory()
    if recording.ground_truth is None:
        return None
    truth = recording.ground_truth[: len(poses)]
    return evaluate_poses(poses, truth) if np.isfinite(truth).all((1, 2)).any() else None


def _trajectory(slam: Slam, recording: FrameSource) -> Trajectory:
    poses = slam.trajectory()
    return Trajectory(recording.timestamps[: len(poses)], poses)


def _write_poses(
    folder: Path, slam: Slam, recording: FrameSource, config: Config, source: result_folder.Source | None, prior: PriorMap | None
) -> set[str]:
    """Trajectory, keyframes, config and the trajectory's picture; the names of the files."""
    trajectory = _trajectory(slam, recording)
    with atomic_files.replacing(folder / result_folder.TRAJECTORY) as part:
        save_tum(part, trajectory)
    adopted = [] if prior is None else prior.keyframes
    own = slam.graph.first_submap[len(adopted) :]
    indices = np.array([keyframe.index for keyframe in own], np.int64)
    poses = np.array([np.asarray(keyframe.T_wk) for keyframe in own], np.float64).reshape(-1, 4, 4)
    earlier = [replace(k.record, T_wk=np.asarray(stored.T_wk)) for k, stored in zip(adopted, slam.graph.keyframes)]
    result_folder.write_keyframes(
        folder, result_folder.KeyframeRecord(recording.camera, indices, recording.timestamps[indices], poses, earlier)
    )
    result_folder.write_config(folder, config, source)
    _draw(folder, slam, recording, indices)
    return {result_folder.TRAJECTORY, result_folder.KEYFRAMES, result_folder.CONFIG, result_folder.PICTURE}


def _draw(folder: Path, slam: Slam, recording: FrameSource, keyframes: NDArray[np.int64]) -> None:
    """The trajectory's picture, beside the true one where there is one."""
    errors, poses = evaluation(slam, recording), slam.trajectory()
    truth = None if errors is None or recording.ground_truth is None else recording.ground_truth[: len(poses)]
    T_gt_est = None if errors is None or errors.ate is None else errors.ate.T_gt_est
    with atomic_files.replacing(folder / result_folder.PICTURE) as part:
        before = slam.live_trajectory() if slam.figures()["loops"] else None
        plot_trajectory(part, poses, truth, T_gt_est=T_gt_est, keyframes=keyframes, before=before)


def _write_map(folder: Path, slam: Slam, mesh: trimesh.Trimesh) -> set[str]:
    """Mesh and map; the names of the files."""
    with atomic_files.replacing(folder / result_folder.MESH) as part:
        mesh.export(part)
    with atomic_files.replacing(folder / result_folder.MAP) as part:
        slam.save_map(part)
    return {result_folder.MESH, result_folder.MAP}


def _write_log(folder: Path, frame_log: FrameLog, slam: Slam) -> set[str]:
    """What the frames were like, and how their poses were found in the end; the name of the file."""
    frame_log.settle(slam.statuses())
    with atomic_files.replacing(folder / result_folder.FRAMES) as part:
        frame_log.save(part)
    return {result_folder.FRAMES}
