"""Runs a suite, row by row, and keeps the rows that are finished: what was interrupted goes on where it was."""

import hashlib
import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from idfslam import __version__
from idfslam.batch.executor import INTERRUPTED, Executor
from idfslam.benchmark.machine import machine
from idfslam.benchmark.processes import BenchError, run_module
from idfslam.benchmark.published import published_figures, sequence_of
from idfslam.benchmark.reproduction.evaluate_row import PROTOCOL
from idfslam.benchmark.reproduction.suite import RECONSTRUCTION, TRACKING, Job, Suite
from idfslam.config import Config, as_yaml, dump
from idfslam.errors import ResultError
from idfslam.runs import result_folder
from idfslam.runs.frame_log import FrameLog
from idfslam.runs.metrics import headline, read_metrics
from idfslam.runs.run_folder import open_for_runs
from idfslam.storage.json_file import read_json
from idfslam.storage.ledger import Ledger

REPORT, TABLE, PAGE, MATCHES = "reproduce.json", "reproduce.md", "reproduce.html", "matches.png"
_SOURCE = "iDF-SLAM"  # of published figures: the paper itself


def run_suite(
    suite: Suite,
    folder: Path,
    executor: Executor,
    *,
    seed: int = 0,
    device: str = "auto",
    overwrite: bool = False,
    report: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Runs every job that has no finished row yet. Results go to FOLDER/NAME; FOLDER/reproduce.json is rewritten after each row.

    A row is finished if the run of the same recording, values and version of the program was. A run that fails is a row that says why, and
    is tried again next time. overwrite: all rows are made anew. After Ctrl-C no further run is started, and the rows so far are returned.
    Raises ConfigError, before the first run, for values that cannot work, and ResultError for a folder that holds anything but results.
    """
    configs = {job.name: job.config(seed, device) for job in suite.jobs}
    keys = {job.name: _fingerprint(job, configs[job.name]) for job in suite.jobs}
    files = [REPORT, TABLE, PAGE, MATCHES, *(f"{name}.yaml" for name in configs)]
    with open_for_runs(folder, list(configs), files, overwrite=True) as ledger:
        rows = {} if overwrite else _finished(folder, keys)
        values = {"machine": machine(), "protocol": PROTOCOL, "workers": executor.workers, "small": suite.small, "notes": list(suite.notes)}
        values |= {"seed": seed, "printed": _printed(), "rows": []}
        lock, waiting = threading.Lock(), [job for job in suite.jobs if job.name not in rows]
        if len(waiting) < len(suite.jobs):
            report(f"{len(suite.jobs) - len(waiting)} of {len(suite.jobs)} rows are finished already")

        def save() -> dict[str, Any]:
            found = values | {"rows": [rows[job.name] for job in suite.jobs if job.name in rows]}
            ledger.write_json(REPORT, found)
            return found

        def run_one(job: Job) -> dict[str, Any]:
            row = _run(ledger, executor, job, configs[job.name]) | {"fingerprint": keys[job.name]}
            with lock:
                if row.get("failed") != INTERRUPTED:
                    rows[job.name] = row
                save()
            return row

        try:
            for row in executor.map_unordered(run_one, waiting):
                report(f"{len(rows)} of {len(suite.jobs)}: {row['name']}: {_line(row)}")
        except KeyboardInterrupt:
            report("interrupted: the finished rows are kept; the same command goes on with the others")
        return save()


def _run(ledger: Ledger, executor: Executor, job: Job, config: Config) -> dict[str, Any]:
    """One row: a run and its evaluation, or the reason of the failure."""
    scene, out = job.scene, ledger.folder.absolute() / job.name
    row: dict[str, Any] = {
        "name": job.name,
        "scene": scene.name,
        "table": scene.table,
        "sequence": sequence_of(scene.path),
        "path": scene.path,
        "frames": scene.frames,
        "stride": scene.stride,
        "gt_mesh": None if scene.gt_mesh is None else str(scene.gt_mesh),
        "method": job.method,
        "variant": job.variant,
    }
    ledger.write_text(f"{job.name}.yaml", as_yaml(config))
    words = ["--frames", str(scene.frames)] if scene.frames is not None else []
    words += ["--stride", str(scene.stride), "--config", str(ledger.folder.absolute() / f"{job.name}.yaml"), "--no-report", "--overwrite"]
    truth = [] if scene.gt_mesh is None else ["--gt-mesh", str(scene.gt_mesh)]
    try:
        run_module(executor, "idfslam.cli", "run", scene.path, "--out", str(out), *words)
        run_module(executor, "idfslam.benchmark.reproduction.evaluate_row", str(out), *truth)
        return row | _measured(out)
    except (BenchError, ResultError) as error:
        return row | {"failed": str(error)}


def _measured(out: Path) -> dict[str, Any]:
    metrics = read_metrics(out)
    evaluation = read_json(out / result_folder.EVALUATION, error=BenchError, expected="the evaluation of a run")
    ate, mesh = evaluation["ate_m"], evaluation.get("mesh") or {}
    return {
        "ate_rmse_cm": ate["rmse"] * 100,
        "ate_mean_cm": ate["mean"] * 100,
        "ate_median_cm": ate["median"] * 100,
        **{f"{key}_cm": mesh[key] * 100 for key in ("accuracy", "completion") if key in mesh},
        **({"completion_ratio_percent": mesh["completion_ratio"] * 100} if mesh else {}),
        "processed": metrics["frames"],
        "seconds": metrics["seconds"],
        "frames_per_second": metrics["frames_per_second"],
        "peak_memory_mb": metrics.get("peak_memory_mb"),
        "peak_gpu_memory_mb": metrics.get("peak_gpu_memory_mb"),
        "keyframes": metrics["keyframes"],
        "lost_frames": metrics["lost_frames"],
        "finetuning_steps": _finetuning_steps(out),
    }


def _finetuning_steps(out: Path) -> int:
    """The frames of a run that finetuned the tracker, by their losses."""
    lines = FrameLog.load(result_folder.existing(out, result_folder.FRAMES)).lines
    return sum(any(name.startswith("finetune_") for name in line.losses) for line in lines)


def _line(row: dict[str, Any]) -> str:
    if "failed" in row:
        return f"failed: {row['failed']}"
    return headline(row["processed"], row["frames_per_second"], row["ate_rmse_cm"] / 100)


def _fingerprint(job: Job, config: Config) -> str:
    """What decides a row's result, as a hash."""
    scene = job.scene
    of = [scene.path, scene.frames, scene.stride, str(scene.gt_mesh), dump(config), __version__, PROTOCOL]
    return hashlib.sha256(json.dumps(of, sort_keys=True, default=str).encode()).hexdigest()[:16]


def _finished(folder: Path, keys: dict[str, str]) -> dict[str, dict[str, Any]]:
    """The rows of an earlier call that stand, by name."""
    if not (folder / REPORT).is_file():
        return {}
    found = read_json(folder / REPORT, error=ResultError, expected="the rows of `idf-slam reproduce`: make them anew with --overwrite")
    rows = found.get("rows") if isinstance(found, dict) else None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ResultError(
            f"{folder / REPORT}: has no list of rows, expected those of `idf-slam reproduce`: make them anew with --overwrite"
        )
    same = [row for row in rows if row.get("fingerprint") == keys.get(str(row.get("name"))) and "failed" not in row]
    return {row["name"]: row for row in same if (folder / row["name"]).is_dir()}


def _printed() -> list[dict[str, Any]]:
    """What the paper prints in its tables."""
    own = [figure for figure in published_figures() if figure.source.startswith(_SOURCE)]
    return [{"sequence": f.sequence, "method": f.method, "metric": f.metric, "value": f.value, "table": _table_of(f.sequence)} for f in own]


def _table_of(sequence: str) -> str:
    return TRACKING if sequence.startswith("scannet") else RECONSTRUCTION


def check_rows(results: dict[str, Any], suite: Suite, folder: Path) -> None:
    """Raises ResultError if a run failed, and KeyboardInterrupt if some were not run, so that the exit status shows it."""
    failed = [row for row in results["rows"] if "failed" in row]
    if failed:
        raise ResultError(
            f"{len(failed)} of {len(suite.jobs)} runs failed ({failed[0]['name']}: {failed[0]['failed']}); see {folder / PAGE}"
        )
    if len(results["rows"]) < len(suite.jobs):
        raise KeyboardInterrupt
