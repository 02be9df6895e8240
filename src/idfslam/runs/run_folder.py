"""The result folder of a run that goes on: locked, and with the earlier results in it until those of the run are complete.

The run writes into a hidden folder inside, and its checkpoint beside that. When the results are complete, they are moved into their places
and the earlier ones go. A run that is killed leaves the hidden folder with its config.yaml, from which it can be resumed.
"""

import logging
import os
import shutil
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from idfslam.errors import ResultError
from idfslam.runs import result_folder
from idfslam.storage import atomic_files, output_folder
from idfslam.storage.ledger import LEDGER, Ledger

log = logging.getLogger(__name__)

_LAST = (result_folder.METRICS, result_folder.CONFIG)  # moved last: until then the hidden config.yaml says that the run is not over


def is_unfinished(folder: Path) -> bool:
    """Whether the folder holds a run that `resume` continues: killed, interrupted or failed."""
    if (folder / result_folder.CHECKPOINT).exists() or (folder / output_folder.PARTIAL / result_folder.CONFIG).exists():
        return True
    return (folder / result_folder.CONFIG).exists() and not (folder / result_folder.METRICS).exists()


def refuse_results(folder: Path) -> None:
    """Raises ResultError for a folder with results or an unfinished run."""
    if is_unfinished(folder):
        raise ResultError(f"{folder}: holds an unfinished run; continue it with --resume {folder}, or replace it with --overwrite")
    if Ledger(folder).names:
        raise ResultError(f"{folder}: holds results already; replace them with --overwrite, or choose another folder with --out")


def config_folder(folder: Path) -> Path:
    """Where the config.yaml of the run that `resume` continues lies."""
    partial = folder / output_folder.PARTIAL
    return partial if (partial / result_folder.CONFIG).is_file() else folder


def check_usable(folder: Path, *, overwrite: bool, report: bool = False) -> None:
    """Raises the errors of `claimed` that are known without making the folder; to be called before a recording is opened, say.

    report: also if a file that the program did not write is in the place of the report or of a picture of it.
    """
    output_folder.refuse_foreign(folder)
    output_folder.refuse_unwritable(folder)
    if folder.is_dir():
        with output_folder.locked(folder):
            if not overwrite:
                refuse_results(folder)
            if report:
                Ledger(folder).refuse_foreign(result_folder.report_files(folder))


@contextmanager
def open_for_runs(folder: Path, runs: Iterable[str], files: Collection[str], *, overwrite: bool) -> Iterator[Ledger]:
    """Locks a folder for several runs, each in a folder of its own inside, and for files about all of them.

    Raises ResultError, before anything is changed, as `claimed` does, also for what is in the folders of the runs.
    """
    output_folder.refuse_foreign(folder)
    for name in runs:
        output_folder.refuse_foreign(folder / name)
        if not overwrite:
            refuse_results(folder / name)
    with output_folder.locked(folder):
        ledger = Ledger(folder)
        ledger.refuse_foreign(files)
        ledger.record()
        yield ledger


def folder_for(name: str, out: Path | None, *, overwrite: bool) -> Path:
    """`out`, or else results/NAME, with a number behind it if that is taken and not to be overwritten."""
    if out is not None or overwrite:
        return out or Path("results") / name
    folder = output_folder.free_name(Path("results") / name)
    if folder.name != name:
        log.info("results/%s is taken: the results go to %s", name, folder)
    return folder


class RunFolder:
    """A folder that this process has locked for a run. `partial` is where the run writes."""

    def __init__(self, path: Path, *, made: bool, replaces: bool) -> None:
        """made: for this run. replaces: the folder holds results of another run, which stay until those of this one are complete."""
        self.path, self.partial = path, path / output_folder.PARTIAL
        self._made, self._replaces, self._worthless = made, replaces, False

    def swap(self) -> None:
        """Moves the run's results into their places. Earlier results go, with what was made of them, such as a report."""
        ledger, new = Ledger(self.path), self._written()
        ledger.record(new, at=self.partial)  # first, so that a file has an owner however this ends
        for name in new:
            os.replace(self.partial / name, self.path / name)
        ledger.remove(ledger.names - set(new))
        shutil.rmtree(self.partial, ignore_errors=True)

    def discard(self) -> None:
        """Says that nothing of what the run has written is worth keeping after its failure."""
        self._worthless = True

    def leave(self) -> None:
        """Without `swap` before, moves what the run has written into its place; beside the results of another run it stays in `partial`."""
        if not self.partial.is_dir():
            return
        written = [] if self._worthless else self._written()
        if not written:
            shutil.rmtree(self.partial, ignore_errors=True)
            self._unmark()
        elif not self._replaces:
            self.swap()
        elif result_folder.TRAJECTORY in written:
            log.warning("%s: the earlier results stay; the poses of this run are in %s", self.path, self.partial)

    def _written(self) -> list[str]:
        """The names of the complete files in `partial`, in the order in which they are moved."""
        names = sorted(path.name for path in self.partial.iterdir() if not path.name.startswith("."))
        return sorted(names, key=lambda name: _LAST.index(name) if name in _LAST else -1)

    def _unmark(self) -> None:
        """Removes the mark of a folder without results; from an empty one the lock, and the folder if it was made for this run.

        A folder that was reserved for the run (`folder_for`) is left with nothing in it, so that the next run gets its name.
        """
        if not Ledger(self.path).names and not (self.path / result_folder.CHECKPOINT).exists():
            (self.path / LEDGER).unlink(missing_ok=True)
            if output_folder.is_empty(self.path):
                (self.path / output_folder.LOCK).unlink(missing_ok=True)
                if self._made:
                    with suppress(OSError):
                        self.path.rmdir()


@contextmanager
def claimed(path: Path, *, overwrite: bool = False, resume: bool = False, writes: Collection[str] = ()) -> Iterator[RunFolder]:
    """Locks a folder for a run until the `with` block ends. What a run that fails has written so far is kept.

    overwrite: the run may replace earlier results. resume: it continues the run of the folder. writes: names of files that the run writes
    besides those of every run.
    Raises ResultError, before anything is changed, for a folder that cannot be written to or is in use, that holds anything but results, or
    that holds results or an unfinished run and neither `overwrite` nor `resume` is given; and for a file in the place of a result that
    somebody else put there.
    """
    output_folder.refuse_foreign(path)
    made = not path.exists()
    with output_folder.locked(path):
        output_folder.refuse_foreign(path)  # somebody may have written there since
        if not overwrite and not resume:
            refuse_results(path)
        ledger = Ledger(path)
        edited = {result_folder.CONFIG} if resume else set()  # a run may be resumed with the new path of its recording
        ledger.refuse_foreign({*result_folder.FILES, *writes} - edited)
        folder = RunFolder(path, made=made, replaces=_has_results_of_another(path, resume))
        if not resume:
            _forget_unfinished(path)
        try:
            ledger.record()
            atomic_files.prepare(path)
            atomic_files.prepare(folder.partial)
        except OSError as error:
            raise atomic_files.unusable(path, error) from error
        try:
            yield folder
        finally:
            with suppress(OSError):
                folder.leave()


def _has_results_of_another(path: Path, resume: bool) -> bool:
    if not any((path / name).exists() for name in result_folder.FILES):
        return False
    return not resume or config_folder(path) != path


def _forget_unfinished(path: Path) -> None:
    """Deletes the checkpoint of an earlier run, and what that wrote besides results."""
    checkpoint = path / result_folder.CHECKPOINT
    if is_unfinished(path):
        log.warning("%s: replaces an unfinished run, which --resume would have continued", path)
    checkpoint.unlink(missing_ok=True)
    shutil.rmtree(path / output_folder.PARTIAL, ignore_errors=True)
