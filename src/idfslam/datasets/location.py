"""Where a recording is that a user names: an address, an archive, a folder around it, a part of it."""

import atexit
import functools
import logging
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import TypeVar
from urllib.parse import unquote

from idfslam.datasets.images.decoding import hidden
from idfslam.errors import ArchiveError, RecordingError
from idfslam.storage.unpack import SUFFIXES, unpack

log = logging.getLogger(__name__)

_LEVELS_UP = 2  # folders above a named file or folder in which the recording around it is looked for; raised, one further away is taken
_LEVELS_DOWN = 2  # folders below one in which a recording is looked for; raised, one further away is taken
_MOST_FOLDERS = 1000  # folders that are looked into below; raised, a wrong path takes longer to be refused. All three chosen by hand

T = TypeVar("T")


def without_scheme(path: Path | str) -> str:
    """The path of a file:// address; other paths as they are."""
    match = re.fullmatch(r"file:/{1,}(localhost/)?(?P<path>.*)", str(path), re.DOTALL)  # pathlib makes one slash of several
    return f"/{unquote(match['path'])}" if match else str(path)


def locate(path: Path, recognise: Callable[[Path], T | None], recognise_around: Callable[[Path], T | None]) -> tuple[Path, T] | None:
    """The place of the recording that `path` names, and what it is recognised as; None if there is none.

    It is the path itself, what an archive unpacks to, the only recording or the only archive in a folder, or the recording around a file or
    folder (`recognise_around`). A warning says so if it is not the path itself. Raises RecordingError if a folder holds several recordings,
    or if an archive cannot be unpacked.
    """
    if (kind := recognise(path)) is not None:
        return path, kind
    if path.is_file() and path.name.lower().endswith(SUFFIXES):
        return locate(_unpacked(path), recognise, recognise_around)
    for level in range(1, _LEVELS_DOWN + 1):
        inner = [(folder, kind) for folder in _folders(path, level) if (kind := _if_readable(folder, recognise)) is not None]
        if len(inner) > 1:
            names = ", ".join(str(folder.relative_to(path)) for folder, _ in inner[:6])
            raise RecordingError(f"{path}: holds {len(inner)} recordings ({names}), expected one: name {inner[0][0]}")
        if inner:
            log.warning("%s: the recording in it, %s, is read", path, inner[0][0].relative_to(path))
            return inner[0]
    if (archive := _only_archive(path)) is not None:
        return locate(archive, recognise, recognise_around)
    if path.is_dir() and not any(path.iterdir()):
        return None  # an empty folder is a part of no recording
    for folder in islice(path.parents, _LEVELS_UP):
        if (kind := recognise_around(folder)) is not None:
            log.warning("%s: a part of the recording %s, which is read", path, folder)
            return folder, kind
    return None


def _if_readable(folder: Path, recognise: Callable[[Path], T | None]) -> T | None:
    """What a folder is recognised as; None if it may not be read: others beside it may."""
    try:
        return recognise(folder)
    except PermissionError:
        return None


def _only_archive(path: Path) -> Path | None:
    """The archive in a folder without folders, if there is one only."""
    entries = [entry for entry in path.iterdir() if not hidden(entry)] if path.is_dir() else []
    archives = [entry for entry in entries if entry.is_file() and entry.name.lower().endswith(SUFFIXES)]
    return archives[0] if len(archives) == 1 and not any(entry.is_dir() for entry in entries) else None


def _folders(path: Path, level: int) -> Iterator[Path]:
    """The folders `level` levels below a path, sorted, without hidden ones."""
    folders = (entry for entry in sorted(path.glob("/".join("*" * level))) if entry.is_dir() and not hidden(entry))
    return islice(folders, _MOST_FOLDERS)


def _unpacked(archive: Path) -> Path:
    status = archive.stat()
    return _unpack_once(archive, status.st_mtime_ns, status.st_size)


@functools.cache
def _unpack_once(archive: Path, mtime_ns: int, size: int) -> Path:
    """The folder with an archive's content, named as the archive. It is removed when the program ends."""
    parent = Path(tempfile.mkdtemp(prefix="idf-slam-"))
    atexit.register(shutil.rmtree, parent, ignore_errors=True)
    suffix = next(suffix for suffix in SUFFIXES if archive.name.lower().endswith(suffix))
    folder = parent / (archive.name[: -len(suffix)] or archive.name)
    folder.mkdir()
    log.warning("%s: an archive, unpacked to %s until the program ends", archive, folder)
    try:
        unpack(archive, folder)
    except ArchiveError as error:
        shutil.rmtree(parent, ignore_errors=True)
        hint = "copy it again, or unpack it yourself and name the folder"
        raise RecordingError(f"{archive.parent}/{error}: {hint}") from error
    return folder
