"""The ledger of a folder: which of its files this program wrote. Nothing else in the folder is replaced or deleted.

`.idf-slam.json` marks the folder as one of this program's. It holds the SHA-256 of each file as it was written, so that a file that
somebody else put there, or changed, is told from the program's own.
"""

import os
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath
from typing import Any

from idfslam.errors import ResultError
from idfslam.storage import atomic_files
from idfslam.storage.json_file import read_json
from idfslam.storage.sha256 import sha256

LEDGER = ".idf-slam.json"
_ABOUT = "SHA-256 of the files that idf-slam wrote here; all others are left alone"
SCHEMA = 1  # counts up with each change that older versions cannot read


class Ledger:
    """The files that this program wrote into a folder. An unmarked folder has an empty one, which `record` writes."""

    def __init__(self, folder: Path) -> None:
        """Raises ResultError if the folder was marked by a later version."""
        self.folder = folder
        found = _read(folder / LEDGER)
        self.marks = found is not None  # whether the folder is marked as this program's
        self._names = found or {}  # SHA-256 of a content -> the name of its file

    @property
    def names(self) -> set[str]:
        """The files that the program wrote, whether they still exist or not; those in sub-folders with slashes."""
        return set(self._names.values())

    def owns(self, name: str) -> bool:
        """Whether the file exists as the program wrote it."""
        path = self.folder / name
        return path.is_file() and not path.is_symlink() and sha256(path) in self._names

    def refuse_foreign(self, names: Collection[str], *, advice: str = "move it away or rename it") -> None:
        """Raises ResultError, with what to do, if one of the files exists and is not as the program wrote it."""
        for name in sorted(names):
            if os.path.lexists(self.folder / name) and not self.owns(name):
                found = "was changed since idf-slam wrote it" if name in self.names else "was not written by idf-slam"
                raise ResultError(f"{self.folder / name}: {found}, so it is not replaced; {advice}")

    def record(self, names: Collection[str] = (), *, at: Path | None = None) -> None:
        """Enters files as they are now, in the folder or in the place `at` from where they will be moved there. Marks the folder."""
        self._names |= {sha256((at or self.folder) / name): name for name in names}
        atomic_files.write_json(self.folder / LEDGER, {"schema": SCHEMA, "about": _ABOUT, "files": self._names})
        self.marks = True

    def remove(self, names: Collection[str]) -> None:
        """Deletes those of the files that exist as the program wrote them, and the sub-folders that are then empty."""
        for path in [self.folder / name for name in names if self.owns(name)]:
            path.unlink()
            if path.parent != self.folder and not any(path.parent.iterdir()):
                path.parent.rmdir()

    @contextmanager
    def replacing(self, name: str) -> Iterator[Path]:
        """Yields a temporary path; it becomes the file `name`, which is entered. Raises ResultError if that is not the program's own."""
        self.refuse_foreign([name])
        with atomic_files.replacing(self.folder / name) as part:
            yield part
        self.record([name])

    def write_text(self, name: str, text: str) -> None:
        """Replaces the file `name` by a text. Raises as `replacing` does."""
        with self.replacing(name) as part:
            part.write_text(text, encoding="utf-8")

    def write_json(self, name: str, values: Any) -> None:
        """Replaces the file `name` by values as JSON. Raises as `replacing` does."""
        with self.replacing(name) as part:
            atomic_files.write_json(part, values)


def _read(path: Path) -> dict[str, str] | None:
    """The content of a ledger; None if there is none, or if it is damaged: then nothing in the folder counts as the program's own."""
    try:
        values = read_json(path, error=ResultError, expected="the ledger of a folder")
        schema, files = values["schema"], {str(digest): str(name) for digest, name in values["files"].items()}
    except (ResultError, KeyError, TypeError, AttributeError):
        return None
    if isinstance(schema, int) and schema > SCHEMA:
        raise ResultError(f"{path}: has schema {schema}, expected at most {SCHEMA}; use the version of idf-slam that wrote this folder")
    return {digest: name for digest, name in files.items() if _lies_inside(name)}


def _lies_inside(name: str) -> bool:
    """Whether a name leads to a file in the folder. One made by somebody else must not reach the user's other files."""
    return not PurePath(name).is_absolute() and not PurePath(name).drive and ".." not in PurePath(name).parts
