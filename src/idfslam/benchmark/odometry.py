"""The benchmark of the tracker alone, frame to keyframe: with and without finetuning and the grid of matches (Secs. V, V-A, V-B).

Frames are not aligned to the map, keyframes are not refined, and loops are not closed. A map is learnt only if finetuning renders it.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from idfslam.batch.recordings import RecordingSpec, parse_recordings
from idfslam.benchmark.machine import machine
from idfslam.benchmark.table import Column, MeanStd, markdown_table
from idfslam.config import Config
from idfslam.datasets import Dataset, open_recording
from idfslam.errors import ConfigError, DivergedError, RecordingError
from idfslam.runs.metrics import keyframe_counts, pose_errors
from idfslam.runs.source import read_frames
from idfslam.slam import Slam
from idfslam.storage import atomic_files
from idfslam.storage.ledger import Ledger

REPORT, TABLE = "odometry.json", "odometry.md"
COLUMNS = (
    Column("ate_m", "ATE RMSE [cm]", 100),
    Column("rpe_1_m", "RPE, 1 frame [cm]", 100),
    Column("rpe_1_deg", "[°]"),
    Column("rpe_30_m", "30 frames [cm]", 100),
    Column("rpe_30_deg", "[°]"),
    Column("lost_frames", "lost frames", digits=1),
    Column("keyframes", "keyframes", digits=1),
    Column("finetuning_rollbacks", "undone", digits=1),
    Column("ms_a_frame", "ms a frame", digits=0),
    Column("ms_finetuning", "of these finetuning", digits=0),
)


def odometry(config: Config, *, finetune: bool, grid: int) -> Config:
    """The config with everything but the tracker turned off."""
    first, each = (config.mapper.first_iterations, config.mapper.iterations) if finetune else (0, 0)
    return replace(
        config,
        front_end="registration",
        tracker=replace(config.tracker, grid=grid),
        finetune=replace(config.finetune, enabled=finetune),
        loops=replace(config.loops, enabled=False, relocalise=False),
        mapper=replace(config.mapper, pose_optimisation=False, every=0, first_iterations=first, iterations=each),
    )


def bench_odometry(
    recordings: Sequence[str],
    config: Config,
    *,
    seeds: int = 3,
    folder: Path | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Measures errors, lost frames and time of the tracker on each recording, with and without finetuning and with and without the grid.

    The seeds are config.seed, config.seed + 1, ...; a combination without anything random runs once. If `folder` is given, JSON and table
    are rewritten there after each combination. If the loss of a run diverges, the report says so and the others continue.
    Raises ConfigError or RecordingError, before the first run, for recordings or values that cannot be measured.
    """
    if seeds < 1:
        raise ConfigError(f"--seeds {seeds}, expected at least 1")
    opened = [(spec, _open_with_poses(spec)) for spec in parse_recordings(recordings)]
    if folder is not None:
        Ledger(folder).refuse_foreign([REPORT, TABLE])
        atomic_files.prepare(folder)
    results: dict[str, Any] = {"machine": machine(), "preset": config.preset, "rows": []}
    grids = dict.fromkeys((config.tracker.grid, 1))
    for (spec, recording), finetune, grid in itertools.product(opened, (False, True), grids):
        values = odometry(config, finetune=finetune, grid=grid)
        random = finetune or values.tracker.consensus == "random"
        runs = [_run(recording, replace(values, seed=config.seed + i)) for i in range(seeds if random else 1)]
        row = {"recording": spec.name, "finetuning": finetune, "grid": grid, "runs": runs, "summary": _summary(runs)}
        results["rows"].append(row)
        report(" ".join(_cells(row)[:4]) + ": " + ", ".join(_result_text(run) for run in runs))
        if folder is not None:
            Ledger(folder).write_json(REPORT, results)
            Ledger(folder).write_text(TABLE, markdown(results))
    return results


def _open_with_poses(spec: RecordingSpec) -> Dataset:
    recording = open_recording(spec.path, frames=spec.frames)
    if recording.ground_truth is None or not np.isfinite(recording.ground_truth).all((1, 2)).any():
        raise RecordingError(f"{recording.name}: has no ground truth, expected poses to compare with; choose a recording that has them")
    return recording


def _run(recording: Dataset, config: Config) -> dict[str, Any]:
    """The measured values of one run, or the reason of the failure."""
    slam = Slam(config)
    try:
        for frame, _ in read_frames(recording):
            slam.process(frame)
    except DivergedError as error:
        return {"seed": config.seed, "failed": str(error)}
    errors = pose_errors(slam, recording)
    assert errors is not None
    rpe = {f"rpe_{e.delta}_{unit}": value for e in errors.rpe for unit, value in (("m", e.translation.rmse), ("deg", e.rotation.rmse))}
    ms = {stage: sum(times) / len(recording) for stage, times in slam.timings.items()}
    times = {"ms_a_frame": sum(ms.values()), "ms_finetuning": ms.get("finetune", 0.0) + ms.get("map", 0.0)}
    return {"seed": config.seed, "frames": len(recording), "ate_m": errors.ate.translation.rmse, **rpe, **keyframe_counts(slam), **times}


def _summary(runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    finished = [run for run in runs if "failed" not in run]
    return {f.key: asdict(MeanStd.of([run[f.key] for run in finished])) for f in COLUMNS if any(f.key in run for run in finished)}


def _result_text(run: Mapping[str, Any]) -> str:
    return f"failed: {run['failed']}" if "failed" in run else f"ATE {run['ate_m'] * 100:.2f} cm, {run['lost_frames']} lost"


def _cells(row: Mapping[str, Any]) -> list[str]:
    """A row of the table."""
    runs, summary = row["runs"], row["summary"]
    finished = sum("failed" not in run for run in runs)
    features = "finetuned" if row["finetuning"] else "as trained"
    figures = [MeanStd(**summary[f.key]).text(f.unit, f.digits) if f.key in summary else "-" for f in COLUMNS]
    return [row["recording"], features, f"grid {row['grid']}", f"{finished} of {len(runs)}", *figures]


def markdown(results: Mapping[str, Any]) -> str:
    """The results as text."""
    rows, m = results["rows"], results["machine"]
    head = f"idf-slam {m['idf-slam']}, preset {results['preset']}, the tracker alone, {m['processor']}, {m['cores']} cores. "
    about = "Mean ± standard deviation over the seeds; a row without anything random ran once."
    table = markdown_table(["recording", "features", "matches", "runs", *(f.title for f in COLUMNS)], [_cells(row) for row in rows])
    failed = [
        f"Failed: {' '.join(_cells(row)[:3])}, seed {run['seed']}: {run['failed']}"
        for row in rows
        for run in row["runs"]
        if "failed" in run
    ]
    return "\n\n".join([head + about, table, *failed]) + "\n"
