"""Folders for output: one that holds anything else is refused before it is touched, and one in use is locked.

The lock is the operating system's, so it ends with its process, however that ends.
"""

import errno
import itertools
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from idfslam.errors import ResultError
from idfslam.storage import atomic_files, file_managers
from idfslam.storage.ledger import LEDGER, Ledger

LOCK, PARTIAL = ".idf-slam.lock", ".idf-slam.partial"
HIDDEN = frozenset({LEDGER, LOCK, PARTIAL})  # what this program puts into a folder besides its results


def is_empty(folder: Path) -> bool:
    """Whether a folder is missing or holds nothing of anybody's. Raises ResultError if it cannot be looked into."""
    folder = Path(os.path.realpath(folder))  # or new/../there would be missing until `new` is made
    try:
        return not folder.exists() or not {path.name for path in folder.iterdir()} - HIDDEN - file_managers.NAMES
    except OSError as error:
        raise atomic_files.unusable(folder, error) from error


def refuse_foreign(folder: Path) -> None:
    """Raises ResultError for a folder that holds something and is not marked as this program's, before anything in it is touched."""
    folder = Path(os.path.realpath(folder))
    if not is_empty(folder) and not Ledger(folder).marks:
        inside = sorted(path.name for path in folder.iterdir() if path.name not in HIDDEN)
        raise ResultError(f"{folder}: is not empty ({inside[0]} ...) and holds no results; choose a new folder with --out")


def refuse_existing(path: Path) -> None:
    """Raises ResultError if there is a file already; to be called where --overwrite was not given."""
    if os.path.lexists(path):
        raise ResultError(f"{path}: exists already; choose another file with --out, or replace it with --overwrite")


def refuse_unwritable(folder: Path) -> None:
    """Raises ResultError for a folder that cannot be made or written to, as far as that is known without touching anything."""
    place = next(path for path in (folder.absolute(), *folder.absolute().parents) if os.path.lexists(path))
    if not place.is_dir():
        raise atomic_files.unusable(folder, OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR)))
    if not os.access(place, os.W_OK | os.X_OK):
        raise atomic_files.unusable(folder, OSError(errno.EACCES, os.strerror(errno.EACCES)))


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Makes the folder and holds its lock. Raises ResultError if another process has it, or if the folder cannot be written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / LOCK)
        lock.acquire(blocking=False)
    except Timeout:
        raise ResultError(f"{folder}: another idf-slam is writing there; wait until it ends, or choose another folder with --out") from None
    except OSError as error:
        raise atomic_files.unusable(folder, error) from error
    try:
        yield
    finally:
        lock.release()


def free_name(folder: Path) -> Path:
    """Makes the folder, or if it holds anything already, the first of folder-2, folder-3 ... that does not."""
    for number in itertools.count(1):
        candidate = folder if number == 1 else folder.with_name(f"{folder.name}-{number}")
        try:
            candidate.parent.mkdir(parents=True, exist_ok=True)
            with suppress(OSError):
                candidate.rmdir()  # an empty one
            candidate.mkdir()
        except FileExistsError:
            if candidate.parent.is_dir():
                continue
            raise ResultError(f"{candidate.parent}: is a file, expected a folder for results; choose another one with --out") from None
        except OSError as error:
            raise atomic_files.unusable(candidate, error) from error
        return candidate
    raise AssertionError("endless")
