"""Matches of the neural tracker with and without the grid that spreads them over the image: the paper's Fig. 5."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from idfslam.benchmark.match_figure import MatchPicture, draw_matches
from idfslam.benchmark.pair_sample import sample
from idfslam.benchmark.registration_methods import LearnedFeatures
from idfslam.benchmark.reproduction.rows import MATCHES
from idfslam.benchmark.reproduction.suite import Job, Suite
from idfslam.datasets import open_recording
from idfslam.errors import RecordingError
from idfslam.pretraining.validation import pose_error
from idfslam.storage import output_folder
from idfslam.storage.ledger import Ledger

_GAP = 20  # frames between the two of the pair; larger: a wider baseline, fewer matches. That of UnsupervisedR&R's pairs


def draw_grid_matches(suite: Suite, folder: Path) -> list[dict[str, float | str]]:
    """Writes FOLDER/matches.png: a pair in the middle of the first scene, with the paper's grid and with none. Returns what each found.

    Without a job of the paper's preset, or with a recording that has no such pair, nothing is written.
    """
    job = next((job for job in suite.jobs if job.method == "paper"), None)
    if job is None:
        return []
    try:
        return _draw(job, folder)
    except RecordingError:
        return []


def _draw(job: Job, folder: Path) -> list[dict[str, float | str]]:
    config = job.config(0, "auto")
    recording = open_recording(job.scene.path, frames=job.scene.frames, stride=job.scene.stride)
    keyframe, frame, T_kc = next(iter(sample(recording, min(_GAP, len(recording) - 1), 1)))
    found, pictures = list[dict[str, float | str]](), []
    for grid in (config.tracker.grid, 1):
        method = LearnedFeatures(replace(config.tracker, grid=grid))
        estimate = method.register(method.describe(frame), method.describe(keyframe))
        rotation, translation = pose_error(estimate.T_kc, T_kc)
        title = f"{grid} x {grid} grid" if grid > 1 else "no grid"
        spread = float(np.prod(estimate.inliers[:, :2].std(0)) ** 0.5) if len(estimate.inliers) else 0.0
        values = {"inliers": float(len(estimate.inliers)), "spread_px": spread, "rotation_deg": rotation, "translation_cm": translation}
        found.append({"matches": title, **values})
        if len(estimate.inliers):
            caption = f"{title}: {len(estimate.inliers)} inliers, {rotation:.1f} degrees and {translation:.1f} cm off"
            pictures.append(MatchPicture(caption, keyframe.colour, frame.colour, estimate.inliers))
    if pictures:
        with output_folder.locked(folder), Ledger(folder).replacing(MATCHES) as part:
            draw_matches(part, pictures)
    return found
