"""Many recordings, each a run of its own, on this machine or a cluster; one table of them all."""

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from json import loads
from pathlib import Path
from typing import Any

import yaml

from idfslam.batch.batch_file import Item
from idfslam.batch.executor import INTERRUPTED, Executor
from idfslam.config import Config, dump
from idfslam.errors import ResultError
from idfslam.runs import result_folder
from idfslam.storage import atomic_files

REPORT, VALUES = "batch.json", "values.yaml"
DONE, FAILED = "done", "failed"


@dataclass(frozen=True)
class Row:
    """What became of a recording."""

    name: str
    path: str
    status: str  # DONE, FAILED or INTERRUPTED
    error: str | None = None
    frames: int | None = None
    ate_m: float | None = None  # RMSE, where the truth is known
    frames_per_second: float | None = None
    lost_frames: int | None = None
    seconds: float = 0.0  # of the process, with its start-up
    where: str = ""
    attempts: int = 1


def batch(
    items: Sequence[Item], config: Config, folder: Path, executor: Executor, *, report: Callable[[str], None] = lambda line: None
) -> list[Row]:
    """Runs every item with its flags over `config`; results in FOLDER/NAME, FOLDER/batch.json written anew after each.

    A run that fails is a row that says why, and the others go on. After Ctrl-C those that run write their results so far, no other begins,
    and the rows of all are returned. Raises ResultError where the folder cannot be written to.
    """
    atomic_files.prepare(folder)
    with atomic_files.replacing(folder / VALUES) as part:
        part.write_text(yaml.safe_dump(dump(config), sort_keys=False), encoding="utf-8")
    rows = {item.name: Row(item.name, item.path, INTERRUPTED, INTERRUPTED, attempts=0) for item in items}
    lock = threading.Lock()

    def one(item: Item) -> Row:
        row = _run(executor, item, folder.absolute())
        with lock:
            rows[item.name] = row
            atomic_files.write_json(folder / REPORT, [asdict(r) for r in rows.values() if r.attempts])
        return row

    try:
        for count, row in enumerate(executor.each(one, items), 1):
            report(f"{count} of {len(items)}: {told(row)}")
    except KeyboardInterrupt:
        report("interrupted: runs that had begun end with their results so far, no other begins")
    return list(rows.values())


def _run(executor: Executor, item: Item, folder: Path) -> Row:
    out = folder / item.name
    done = executor.execute("idfslam.cli", "run", item.path, "--out", str(out), "--config", str(folder / VALUES), *item.flags)
    row = partial(Row, item.name, item.path, seconds=done.seconds, where=done.where, attempts=done.attempts)
    if done.error is not None:
        return row(INTERRUPTED if done.error == INTERRUPTED else FAILED, done.error)
    try:
        metrics: Mapping[str, Any] = loads((out / result_folder.METRICS).read_text(encoding="utf-8"))
    except OSError:
        return row(FAILED, f"{out} is not to be seen from here; expected --out on a file system that all nodes share")
    return row(
        INTERRUPTED if metrics["interrupted"] else DONE,
        frames=metrics["frames"],
        ate_m=metrics["ate_m"]["rmse"] if "ate_m" in metrics else None,
        frames_per_second=metrics["frames_per_second"],
        lost_frames=metrics["lost_frames"],
    )


def told(row: Row) -> str:
    """A row as one line."""
    if row.error is not None:
        return f"{row.name}: {row.status}: {row.error}"
    ate = "" if row.ate_m is None else f", ATE {row.ate_m * 100:.2f} cm"
    return f"{row.name}: {row.frames} frames, {row.frames_per_second:.2f} frames/s{ate}"


def check_done(rows: Sequence[Row], folder: Path) -> None:
    """Raises ResultError if a run failed, so that a script notices, and KeyboardInterrupt if the batch was interrupted."""
    failed = [row for row in rows if row.status == FAILED]
    if failed:
        raise ResultError(f"{len(failed)} of {len(rows)} runs failed ({failed[0].name}: {failed[0].error}); {folder / REPORT} tells of all")
    if any(row.status == INTERRUPTED for row in rows):
        raise KeyboardInterrupt
