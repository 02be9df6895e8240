"""Renders the frames that a run held out, and compares them with the recording."""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idfslam.errors import FrameError, ResultError
from idfslam.evaluation.view_error import ViewError, view_error
from idfslam.frame import Frame
from idfslam.graph.held_out import is_held_out
from idfslam.mapping.saved_map import SavedMap
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.run_config import read_config
from idfslam.views.image_based_rendering import MapViews


@dataclass(frozen=True, eq=False)
class ComparedView:
    """A held-out frame, and what was rendered at its tracked pose."""

    frame: Frame
    colour: NDArray[np.float32]  # (H, W, 3) in [0, 1]
    depth: NDArray[np.float32]  # (H, W) [m]
    error: ViewError


def held_out(run: FinishedRun) -> list[int]:
    """The frames that the run held out and whose pose was measured. Raises ResultError if there is none."""
    every = read_config(run.folder)[0].hold_out
    found = [i for i in range(len(run.trajectory)) if is_held_out(i, every) and run.measured[i]]
    if not found:
        raise ResultError(f"{run.folder}: the run held no frame out; run again with --hold-out 8 to compare views with every eighth frame")
    return found


def compared_views(run: FinishedRun, renderer: MapViews | SavedMap) -> Iterator[ComparedView]:
    """The held-out frames, rendered at their size. Unreadable ones are left out."""
    for i in held_out(run):
        try:
            frame = run.recording[i]
        except FrameError:
            continue
        begun = time.perf_counter()
        colour, depth = renderer.render(run.trajectory.poses[i], frame.camera)
        seconds = time.perf_counter() - begun
        lit = np.ones(depth.shape, bool) if run.archive is None else run.archive.lit
        holes = float((depth[lit] == 0).mean())
        yield ComparedView(frame, colour, depth, view_error(i, colour, frame.colour, lit, holes, seconds))
