"""Unpacks untrusted archives (zip, tar): only regular files and folders, and nothing outside the target folder."""

import logging
import lzma
import stat
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import IO

from idfslam.errors import ArchiveError
from idfslam.storage import file_managers

log = logging.getLogger(__name__)

Member = tuple[str, str, Callable[[], IO[bytes]]]  # name; "file", "folder", "link" or "device"; a function that opens it

SUFFIXES = (".zip", ".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tbz2", ".tar.xz", ".txz")
_DAMAGED = (  # the last five are what the two modules let through of damaged headers
    *(tarfile.TarError, zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError),
    *(ValueError, IndexError, OverflowError, MemoryError, struct.error),
)
_MOST_PER_BYTE = 100  # [1] bytes unpacked from one of an archive; raised, one made to fill the disk gets further. Images give 1 to 3, raw
#    depth up to 50. Chosen by hand
_ALWAYS = 1 << 30  # [bytes] that any archive may unpack to; raised, likewise. Chosen by hand


def unpack(archive: Path, folder: Path) -> None:
    """Unpacks `archive` into `folder`, and each zip file inside it into that file's folder (7-Scenes has one a sequence).

    Links are left out with a warning. Raises ArchiveError if the archive is damaged or encrypted, holds devices or paths outside `folder`,
    unpacks to far more than it could hold, or if the disk is full.
    """
    try:
        room = _Room(archive.name, _ALWAYS + _MOST_PER_BYTE * archive.stat().st_size)
        _unpack(archive, folder, room)
        for inner in sorted(folder.rglob("*.zip")):
            _unpack(inner, inner.parent, room)
            inner.unlink()
    except _DAMAGED as error:
        why = str(error).partition(":")[0] or type(error).__name__  # tarfile tells behind the colon what each method says
        raise ArchiveError(f"{archive.name}: damaged ({why})") from error
    except (NotImplementedError, RuntimeError) as error:  # zipfile's errors for unknown methods and encrypted members
        raise ArchiveError(f"{archive.name}: {error}, expected one that is not encrypted, of a usual method: pack it again") from error
    except OSError as error:
        raise ArchiveError(f"{folder}: {error.strerror or error} while unpacking {archive.name}") from error


class _Room:
    """The bytes that an archive may still unpack to."""

    def __init__(self, name: str, most: int) -> None:
        self._name, self._left = name, most

    def take(self, count: int) -> None:
        self._left -= count
        if self._left < 0:
            raise ArchiveError(f"{self._name}: unpacks to more than a recording of its size can hold: nothing of it is used")


def _unpack(archive: Path, folder: Path, room: _Room) -> None:
    for name, kind, open_member in _zip_members(archive) if _is_zip(archive) else _tar_members(archive):
        if not file_managers.NAMES.isdisjoint(Path(name).parts):  # those in 7-Scenes are damaged
            continue
        target = (folder / name).resolve()
        if not target.is_relative_to(folder.resolve()) or kind == "device" or "\\" in name:
            raise ArchiveError(f"{archive.name}: holds '{name}' ({kind}), expected files and folders inside it: nothing of it is used")
        if kind == "link":
            log.warning("%s: the link '%s' is left out", archive.name, name)
        elif kind == "folder":
            target.mkdir(parents=True, exist_ok=True)
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            with open_member() as source, target.open("wb") as copy:
                while data := source.read(1 << 20):
                    room.take(len(data))
                    copy.write(data)


def _is_zip(archive: Path) -> bool:
    with archive.open("rb") as file:
        return file.read(2) == b"PK"


def _zip_members(archive: Path) -> Iterator[Member]:
    with zipfile.ZipFile(archive) as archive_file:
        for info in archive_file.infolist():
            mode = info.external_attr >> 16  # Unix mode; 0 if the archive was made on another system
            special = stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR)
            kind = "link" if stat.S_ISLNK(mode) else "device" if special else "folder" if info.is_dir() else "file"
            yield info.filename, kind, partial(archive_file.open, info)


def _tar_members(archive: Path) -> Iterator[Member]:
    with tarfile.open(archive) as archive_file:
        for info in archive_file:
            kind = "file" if info.isreg() else "folder" if info.isdir() else "link" if info.issym() or info.islnk() else "device"
            yield info.name, kind, partial(_open_tar_member, archive_file, info)


def _open_tar_member(archive_file: tarfile.TarFile, info: tarfile.TarInfo) -> IO[bytes]:
    file = archive_file.extractfile(info)
    assert file is not None  # a regular file
    return file
