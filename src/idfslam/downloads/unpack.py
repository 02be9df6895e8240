"""Unpacks untrusted archives (zip, tar): only regular files and folders, and nothing outside the target folder."""

import logging
import shutil
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import IO

from idfslam.errors import DownloadError

log = logging.getLogger(__name__)

Member = tuple[str, str, Callable[[], IO[bytes]]]  # name; "file", "folder", "link" or "device"; a function that opens it

_JUNK = ("Thumbs.db", ".DS_Store", "__MACOSX")  # not unpacked: those in 7-Scenes are damaged
_DAMAGED = (tarfile.TarError, zipfile.BadZipFile, zlib.error, EOFError)


def unpack(archive: Path, folder: Path) -> None:
    """Unpacks `archive` into `folder`, and each zip file inside it into that file's folder (7-Scenes has one a sequence).

    Links are left out with a warning. Raises DownloadError if the archive is damaged, holds devices or paths outside `folder`, or if the
    disk is full.
    """
    try:
        _unpack(archive, folder)
        for inner in sorted(folder.rglob("*.zip")):
            _unpack(inner, inner.parent)
            inner.unlink()
    except _DAMAGED as error:
        raise DownloadError(f"{archive.name}: damaged ({error}): download it again") from error
    except OSError as error:
        raise DownloadError(f"{folder}: {error.strerror} while unpacking") from error


def _unpack(archive: Path, folder: Path) -> None:
    for name, kind, open_member in _zip_members(archive) if _is_zip(archive) else _tar_members(archive):
        if any(part in _JUNK for part in Path(name).parts):
            continue
        target = (folder / name).resolve()
        if not target.is_relative_to(folder.resolve()) or kind == "device" or "\\" in name:
            raise DownloadError(f"{archive.name}: holds '{name}' ({kind}), expected files and folders inside it: nothing of it is used")
        if kind == "link":
            log.warning("%s: the link '%s' is left out", archive.name, name)
        elif kind == "folder":
            target.mkdir(parents=True, exist_ok=True)
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            with open_member() as source, target.open("wb") as copy:
                shutil.copyfileobj(source, copy, 1 << 20)


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
