"""The demonstration: SLAM in a generated room, its evaluation against the truth, and pictures. It needs no files."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console

from idfslam.config import Config
from idfslam.datasets import Dataset
from idfslam.datasets.generated.prerendered import Prerendered
from idfslam.demo.compile_ahead import compiling_ahead
from idfslam.evaluation.evaluation import Evaluation
from idfslam.mapping.saved_map import load_map
from idfslam.pictures.image_files import View, draw_views
from idfslam.pictures.mesh_renderer import draw_mesh
from idfslam.report.writing import write_report
from idfslam.runs import result_folder
from idfslam.runs.evaluate_run import evaluate_folder
from idfslam.runs.runner import Run, run
from idfslam.runs.source import open_source
from idfslam.storage import atomic_files

VIEWS = "views.png"
_VIEWS = 4
_AHEAD = 128  # frames rendered while kernels are compiled: 5 MB each
_DEPTH_VIEWS = 200  # for depth L1, a fifth of those of `eval`; more: slower, a surer mean


def demo(
    config: Config, folder: Path, *, room: int, frames: int, report: bool = True, console: Console | None = None
) -> tuple[Run, Evaluation, list[Path]]:
    """Runs SLAM on `frames` frames of the synthetic room number `room`. Returns the run, its errors and the paths of the pictures.

    With `report` the pictures are the report's. Without it they are two: the mesh from outside, and frames next to the rendered map.
    Raises ConfigError for more frames than the tour of the room has, ResultError if the folder cannot be written to.
    """
    source = result_folder.Source(f"synthetic:{room}", frames=frames)
    with compiling_ahead(config) as wait_until_compiled:
        recording = open_source(source)
        recording[0]  # compiles what renders it
        with Prerendered(recording, most=_AHEAD) as prerendered:
            wait_until_compiled()
        done = run(prerendered, config, folder, source=source, console=console)
    evaluation = evaluate_folder(folder, recording=recording, views=_DEPTH_VIEWS)
    if report:
        write_report(folder, recording=recording)
        return done, evaluation, [folder / result_folder.PICTURES]
    poses = done.trajectory.poses
    pictures = draw_mesh(done.mesh, folder, poses=poses, camera=recording.camera, views=0)
    with atomic_files.replacing(folder / VIEWS) as part:
        draw_views(part, list(_views(recording, poses, folder)))
    return done, evaluation, [*pictures, folder / VIEWS]


def _views(recording: Dataset, poses: np.ndarray, folder: Path) -> Iterator[View]:
    """Frames spread over the run, and the saved map rendered from their estimated poses at half the size, enough for the picture."""
    saved = load_map(folder / result_folder.MAP)
    camera = recording.camera.resized(recording.camera.width // 2, recording.camera.height // 2)
    for i in np.unique(np.linspace(0, len(poses) - 1, _VIEWS).round().astype(int)).tolist():
        frame = recording[i]
        colour, depth = saved.render(poses[i], camera)
        yield View(i, frame.colour, frame.depth, np.asarray(colour), np.asarray(depth))
