"""The sections of a report: the figures of each, by the names that the page's template has for them."""

from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.datasets import Dataset
from idfslam.report import figures
from idfslam.report.gallery import Figure, Gallery
from idfslam.report.known_error import KnownError
from idfslam.report.views import RoomPictures, comparisons, moving_strip
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun


def charts(gallery: Gallery, run: FinishedRun, error: KnownError | None, metrics: dict[str, Any]) -> dict[str, list[Figure]]:
    """The charts over time, and the bars of the stages."""
    stamps, errors, times, losses = run.trajectory.timestamps, [], [], []
    if error is not None:
        chart = figures.error_chart(stamps - stamps[0], error.per_frame(len(stamps)), error.ate.translation.rmse)
        errors = gallery.chart("error", "Distance between estimated and true position, trajectories aligned", chart)
    if run.frames is not None and run.frames.lines:
        times = gallery.chart(
            "frames", "Time of each frame, keyframes, and frames whose pose is in doubt", figures.frames_chart(run.frames)
        )
        losses = gallery.chart("losses", "Losses of the map and of the tracker's finetuning", figures.losses_chart(run.frames))
    stages = metrics.get("ms_per_frame")
    background = "; the map learns in the background" if "wait" in (stages or {}) else ""
    bars = gallery.chart("stages", f"Time of each stage{background}", figures.stages_chart(stages)) if stages else []
    return {"error": errors, "frames": times, "stages": bars, "losses": losses}


def room_pictures(
    gallery: Gallery, run: FinishedRun, error: KnownError | None, mesh: trimesh.Trimesh | None, R_lw: NDArray[np.float64]
) -> dict[str, list[Figure]]:
    """The trajectory, the mesh and slices of the map, in level coordinates: R_lw (3, 3) turns the world into them."""
    poses = run.trajectory.poses
    truth = None if error is None else error.true_positions() @ R_lw.T
    path = figures.CameraPath(poses[:, :3, 3] @ R_lw.T, truth, run.keyframes.indices)
    room = RoomPictures(mesh, poses, R_lw) if mesh is not None else None
    plan = None if room is None else room.plan()
    sections = {
        "trajectory": [
            *gallery.chart("trajectory_top", "From above: circle start, square end", figures.trajectory_chart(path, (0, 1), plan)),
            *gallery.chart("trajectory_side", "From the side: x and height", figures.trajectory_chart(path, (0, 2))),
            *gallery.chart("trajectory_front", "From the side: y and height", figures.trajectory_chart(path, (1, 2))),
        ],
        "mesh": [],
        "inside": [],
        "slices": [],
    }
    if room is not None:
        sections["mesh"] = [gallery.picture(f"mesh_{i}", f"From outside, side {i}", image) for i, image in enumerate(room.outside(), 1)]
        sections["inside"] = [gallery.picture(f"inside_{i}", f"From inside, place {i}", image) for i, image in enumerate(room.inside(), 1)]
    if room is not None and (run.folder / result_folder.MAP).is_file():
        for i, (height, plane) in enumerate(room.slices(run.map), 1):
            drawn = figures.slice_chart(f"slice{i}", plane, path, run.map.field.config.truncation)
            sections["slices"] += gallery.chart(f"slice_{i}", f"{height:.2f} m above the lowest surface", drawn)
    return sections


def compared_frames(gallery: Gallery, run: FinishedRun, recording: Dataset | None) -> dict[str, Any]:
    """Frames next to the map rendered from their estimated poses."""
    if recording is None or not (run.folder / result_folder.MAP).is_file():
        return {"views": []}
    rows = []
    for n, comparison in enumerate(comparisons(run.views, recording, run.trajectory.poses), 1):
        shown = [
            gallery.picture(f"view_{n}_{caption.replace(', ', '_').replace(' ', '_')}", caption, image)
            for caption, image in comparison.pictures.items()
        ]
        figures = f"PSNR {comparison.psnr:.1f} dB at its exposure, median depth error {comparison.depth_error * 100:.1f} cm"
        text = f"Frame {comparison.index}: {figures}"
        rows.append((text, shown))
    return {"views": rows}


def moving_images(gallery: Gallery, run: FinishedRun) -> dict[str, list[Figure]]:
    """Images in which something moves."""
    strip = [] if run.archive is None else moving_strip(run.archive)
    return {"moving": [gallery.picture(f"moving_{n}", caption, image) for n, (caption, image) in enumerate(strip, 1)]}
