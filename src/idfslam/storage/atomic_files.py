"""Atomic writing of files: each is written under a temporary name and then renamed, so that no reader sees a half-written file."""

import errno
import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from idfslam.errors import ResultError

_PART = ".part-"  # prefix of the names of files that are being written
_SHOWN = 200  # characters of a path in a message; more: a longer line


def prepare(folder: Path) -> None:
    """Makes the folder, checks that it is writable before anything is computed, and removes half-written files of a killed program.

    Raises ResultError if the folder cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{_PART}check").touch()
        for part in folder.glob(f"{_PART}*"):
            part.unlink()
    except OSError as error:
        raise unusable(folder, error) from error


def unusable(folder: Path, error: OSError) -> ResultError:
    """The error of a folder that cannot be written to."""
    name = str(folder)
    shown = name if len(name) <= _SHOWN else f"{name[: _SHOWN // 2]}...{name[-_SHOWN // 2 :]}"
    found = "is a file" if error.errno in (errno.EEXIST, errno.ENOTDIR) else error.strerror or str(error)
    return ResultError(f"{shown}: results cannot be written there ({found}); choose another folder with --out")


@contextmanager
def replacing(path: Path, *, durable: bool = False) -> Iterator[Path]:
    """Yields a temporary path to write to. It replaces `path` when the context ends, and is deleted after an error.

    durable: the data are on the disk before they replace `path`, so that a power failure leaves the old file or the new one.
    """
    part = path.with_name(f"{_PART}{path.name}")
    try:
        yield part
        if durable:
            _sync(part)
        os.replace(part, path)
        if durable and os.name != "nt":  # Windows cannot open folders
            _sync(path.parent)
    finally:
        part.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    """Waits until a file or folder is on the disk."""
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_json(path: Path, values: Any) -> None:
    """Writes values as JSON, atomically. NaN and infinity, which JSON does not have, become null."""
    with replacing(path) as part:
        part.write_text(json.dumps(_plain(values), indent=2) + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
