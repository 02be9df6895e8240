"""Mutations of one target in this process: each is made from its number, used, and judged."""

import contextlib
import logging
import shutil
import signal
import traceback
import warnings
from collections.abc import Iterator
from pathlib import Path
from random import Random
from types import FrameType

from fuzz.mutations import damage_folder, mutated
from fuzz.targets import Target
from idfslam.errors import IdfSlamError

ACCEPTED, REFUSED, FAULT, HANG = "accepted", "refused", "fault", "hang"
LIMIT = 20  # [s] for one mutation, on a machine that others use too. A hang is one that takes longer
_FOLDER_SHARE = 0.15  # of the mutations of a folder that change its files themselves rather than their content


class _TooLong(BaseException):
    """Raised by the alarm; no `except Exception` of a reader catches it."""


class Campaign:
    """A target's valid files in a folder, and mutations of them."""

    def __init__(self, target: Target, folder: Path) -> None:
        self.target, self._place = target, folder / "place"
        shutil.rmtree(folder, ignore_errors=True)
        self._place.mkdir(parents=True)
        self._path = target.make(self._place)
        self._files = sorted(path for path in self._place.glob(target.files) if path.is_file())
        self._data = {path: path.read_bytes() for path in self._files}
        assert self._files, f"{target.name}: no file matches {target.files}"
        target.use(self._path)  # the valid files must be accepted

    def judge(self, number: int) -> tuple[str, str]:
        """What becomes of mutation `number`: ACCEPTED, REFUSED, FAULT or HANG, and the message or the traceback's last lines."""
        with self._mutation(number):
            return self._outcome()

    @contextlib.contextmanager
    def _mutation(self, number: int) -> Iterator[None]:
        """Damages the files, and puts them right again at the end."""
        rng = Random(f"{self.target.name} {number}")
        if self._path.is_dir() and rng.random() < _FOLDER_SHARE and self.target.files == "**/*":
            kept = self._place.with_name("kept")
            shutil.copytree(self._place, kept)
            try:
                damage_folder(self._path, rng)
                yield
            finally:
                shutil.rmtree(self._place)
                kept.rename(self._place)
            return
        changed = rng.sample(self._files, min(len(self._files), rng.choice((1, 1, 1, 2))))
        for path in changed:
            path.write_bytes(mutated(self._data[path], rng))
        try:
            yield
        finally:
            for path in changed:
                path.write_bytes(self._data[path])

    def keep(self, number: int, folder: Path) -> None:
        """Leaves the files of mutation `number` in `folder`."""
        with contextlib.suppress(shutil.Error, OSError), self._mutation(number):
            shutil.copytree(self._place, folder, symlinks=True, dirs_exist_ok=True)

    def _outcome(self) -> tuple[str, str]:
        with _time_limit():
            try:
                self.target.use(self._path)
            except IdfSlamError as error:
                return (FAULT, f"message of several lines: {error}") if "\n" in str(error) else (REFUSED, str(error))
            except _TooLong as error:
                return HANG, _where(error)
            except BaseException as error:  # what must not happen: any other exception at all
                return FAULT, _where(error)
        return ACCEPTED, ""


@contextlib.contextmanager
def _time_limit() -> Iterator[None]:
    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise _TooLong

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(LIMIT)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _where(error: BaseException) -> str:
    """The error in one line, and the last place in the package."""
    places = [place for place in traceback.extract_tb(error.__traceback__) if "idfslam" in place.filename]
    place = f"{Path(places[-1].filename).name}:{places[-1].lineno}" if places else "outside the package"
    return f"{type(error).__name__}: {' '.join(str(error).split())[:150]} @ {place}"


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Without warnings and logs, of which there would be millions."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            yield
        finally:
            logging.disable(before)
