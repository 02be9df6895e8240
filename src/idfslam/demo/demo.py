"""The demonstration: SLAM in a generated room, its evaluation against the truth, and pictures. It needs no files."""

from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from idfslam.config import Config
from idfslam.datasets import Dataset
from idfslam.datasets.generated.prerendered import Prerendered
from idfslam.evaluation.evaluation import Evaluation
from idfslam.geometry.even_spacing import evenly_spread
from idfslam.mapping.saved_map import SavedMap
from idfslam.pictures.image_files import RenderedView, draw_views
from idfslam.pictures.overview import draw_overview
from idfslam.report.writing import write_report
from idfslam.runs import result_folder
from idfslam.runs.compile_ahead import compiling_ahead
from idfslam.runs.evaluate_run import evaluate_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.keyframes_file import read_keyframes
from idfslam.runs.run_config import RecordingSource
from idfslam.runs.runner import RunResult, run
from idfslam.runs.source import open_source
from idfslam.slam.warm_up import COMPILING, will_compile
from idfslam.storage.ledger import Ledger
from idfslam.views.image_based_rendering import MapViews, without

OVERVIEW, VIEWS = "overview.png", "views.png"
_VIEWS = 4
_WIDE, _SMALL = 480, 320  # [px] width of the map's view in the two pictures; larger: sharper, slower
_SHOWN = 0.4  # share of the run before the frame that stands beside the room. Chosen by hand
_AHEAD = 128  # frames rendered while kernels are compiled: 5 MB each
_DEPTH_VIEWS = 200  # for depth L1, a fifth of those of `eval`; more: slower, a surer mean


def demo(
    config: Config,
    folder: Path,
    *,
    room: int,
    frames: int,
    report: bool = True,
    overwrite: bool = False,
    console: Console | None = None,
) -> tuple[RunResult, Evaluation, list[Path]]:
    """Runs SLAM on `frames` frames of the synthetic room number `room`. Returns the run, its errors and the paths of the pictures.

    The first picture shows the room from outside with the camera's path. The others are the report's; without `report` there is one,
    of frames next to the rendered map.
    overwrite: results in `folder` may be replaced. Raises ConfigError for more frames than the tour of the room has, ResultError as `run`
    does.
    """
    source = RecordingSource(f"synthetic:{room}", frames=frames)
    tell = (lambda stage: None) if console is None else partial(console.print, highlight=False, markup=False, soft_wrap=True)
    tell(f"building the room, {COMPILING}" if will_compile(config) else "building the room")
    with compiling_ahead(config) as wait_until_compiled:
        recording = open_source(source)
        recording[0]  # compiles what renders it
        with Prerendered(recording, most=_AHEAD) as prerendered:
            wait_until_compiled()
        done = run(prerendered, config, folder, source=source, overwrite=overwrite, console=console)
    tell("evaluating")
    evaluation = evaluate_folder(folder, recording=recording, views=_DEPTH_VIEWS)
    renderer, poses = FinishedRun(folder).views, done.trajectory.poses
    keyframes = read_keyframes(folder).indices
    view = _view(recording, poses, renderer, int(len(poses) * _SHOWN), _WIDE)
    with Ledger(folder).replacing(OVERVIEW) as part:
        draw_overview(part, done.mesh, poses, keyframes, recording.camera, view)
    tell("writing the report" if report else "drawing pictures")
    if report:
        write_report(folder, recording=recording)
        return done, evaluation, [folder / OVERVIEW, folder / result_folder.PICTURES]
    chosen = evenly_spread(len(poses), _VIEWS).tolist()
    with Ledger(folder).replacing(VIEWS) as part:
        draw_views(part, [_view(recording, poses, renderer, i, _SMALL) for i in chosen])
    return done, evaluation, [folder / OVERVIEW, folder / VIEWS]


def _view(recording: Dataset, poses: NDArray[np.float64], renderer: MapViews | SavedMap, i: int, width: int) -> RenderedView:
    """Frame i, and the map rendered from its estimated pose in images `width` pixels wide."""
    camera = recording.camera.resized(width, round(width * recording.camera.height / recording.camera.width))
    colour, depth = without(renderer, i).render(poses[i], camera)
    frame = recording[i]
    return RenderedView(i, frame.colour, frame.depth, np.asarray(colour), np.asarray(depth))
