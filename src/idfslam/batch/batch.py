"""Runs many recordings, on this machine or on a cluster, and collects the results in one table."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from idfslam.batch.batch_file import BatchJob
from idfslam.batch.executor import INTERRUPTED, Executor
from idfslam.config import Config, as_yaml
from idfslam.errors import ResultError
from idfslam.runs.metrics import ate_rmse, headline, read_metrics
from idfslam.runs.run_folder import open_for_runs
from idfslam.storage.ledger import Ledger

REPORT, VALUES = "batch.json", "values.yaml"
DONE, FAILED = "done", "failed"


@dataclass(frozen=True)
class Row:
    """The outcome of one recording, as batch.json stores it."""

    name: str
    path: str
    status: str  # DONE, FAILED or INTERRUPTED
    error: str | None = None
    frames: int | None = None
    ate_m: float | None = None  # RMSE [m], if ground truth is known
    frames_per_second: float | None = None
    lost_frames: int | None = None
    seconds: float = 0.0  # of the process, including its start-up
    where: str = ""  # the host
    attempts: int = 1


def batch(
    jobs: Sequence[BatchJob],
    config: Config,
    folder: Path,
    executor: Executor,
    *,
    overwrite: bool = False,
    report: Callable[[str], None] = lambda line: None,
) -> list[Row]:
    """Runs every job with its flags over `config`. Results go to FOLDER/NAME, and FOLDER/batch.json is rewritten after each run.

    If a run fails, its row says why and the others continue. After Ctrl-C no further run is started, running ones write their results so
    far, and the rows of all jobs are returned. overwrite: earlier results of the jobs are replaced, each when its run is complete.
    Raises ResultError, before the first run, if the folder cannot be written to, is in use, or holds anything but results, and without
    `overwrite` if it holds results of a job.
    """
    with open_for_runs(folder, [job.name for job in jobs], [REPORT, VALUES], overwrite=overwrite) as ledger:
        return _run_all(jobs, config, ledger, executor, report)


def _run_all(jobs: Sequence[BatchJob], config: Config, ledger: Ledger, executor: Executor, report: Callable[[str], None]) -> list[Row]:
    folder = ledger.folder
    ledger.write_text(VALUES, as_yaml(config))
    rows = {job.name: Row(job.name, job.path, INTERRUPTED, INTERRUPTED, attempts=0) for job in jobs}
    lock = threading.Lock()

    def run_one(job: BatchJob) -> Row:
        row = _run(executor, job, folder.absolute())
        with lock:
            rows[job.name] = row
            ledger.write_json(REPORT, [asdict(r) for r in rows.values() if r.attempts])
        return row

    try:
        for count, row in enumerate(executor.map_unordered(run_one, jobs), 1):
            report(f"{count} of {len(jobs)}: {progress_line(row)}")
    except KeyboardInterrupt:
        report("interrupted: running jobs write their results so far, no other is started")
    return list(rows.values())


def _run(executor: Executor, job: BatchJob, folder: Path) -> Row:
    out = folder / job.name
    given = ["--out", str(out), "--overwrite", "--config", str(folder / VALUES)]  # a retry replaces what a killed process has left
    outcome = executor.run_module("idfslam.cli", "run", job.path, *given, *job.flags)
    row = partial(Row, job.name, job.path, seconds=outcome.seconds, where=outcome.host, attempts=outcome.attempts)
    if outcome.error is not None:
        return row(INTERRUPTED if outcome.error == INTERRUPTED else FAILED, outcome.error)
    try:
        metrics = read_metrics(out)
    except ResultError:
        return row(FAILED, f"{out} is not visible from this machine; expected --out on a file system that all nodes share")
    return row(
        INTERRUPTED if metrics.get("interrupted") else DONE,
        frames=metrics.get("frames"),
        ate_m=ate_rmse(metrics),
        frames_per_second=metrics.get("frames_per_second"),
        lost_frames=metrics.get("lost_frames"),
    )


def progress_line(row: Row) -> str:
    """A row as one line of text."""
    if row.frames is None or row.frames_per_second is None:
        return f"{row.name}: {row.status}: {row.error}"
    return f"{row.name}: {headline(row.frames, row.frames_per_second, row.ate_m)}"


def check_done(rows: Sequence[Row], folder: Path) -> None:
    """Raises ResultError if a run failed, and KeyboardInterrupt if the batch was interrupted, so that the exit status shows it."""
    failed = [row for row in rows if row.status == FAILED]
    if failed:
        raise ResultError(f"{len(failed)} of {len(rows)} runs failed ({failed[0].name}: {failed[0].error}); {folder / REPORT} lists all")
    if any(row.status == INTERRUPTED for row in rows):
        raise KeyboardInterrupt
