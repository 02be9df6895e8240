"""transform.json: what earlier exports wrote into a folder, and the axes of these files. Files of the user's own are not replaced.

up                the axis that points up in the newest export: z, y or camera
T_export_world    (4 x 4, by rows) from the run's world, which is the first camera (x right, y down, z forward), into these axes
exports           for each format: its own up and T_export_world, and the SHA-256 of its files
"""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from idfslam.errors import ResultError
from idfslam.export.axes import Axes
from idfslam.storage import atomic_files
from idfslam.storage.json_file import read_json

RECORD = "transform.json"


@dataclass
class ExportRecord:
    """The content of transform.json in `folder`."""

    folder: Path
    axes: Axes  # of the newest export
    exports: dict[str, Any] = field(default_factory=dict)  # by format

    @staticmethod
    def of(folder: Path, axes: Axes) -> "ExportRecord":
        """A new export's record, with what is known of earlier ones. A transform.json of another program raises ResultError."""
        path = folder / RECORD
        if not path.is_file():
            return ExportRecord(folder, axes)
        try:
            exports = read_json(path, error=ResultError, expected="the record of an earlier export")["exports"]
            for export in exports.values():
                dict(export["files"])
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ResultError(f"{path}: is no record of an earlier export; choose another folder with --out, or move the file") from error
        return ExportRecord(folder, axes, exports)

    def refuse_to_replace(self, paths: Iterable[Path]) -> None:
        """Raises ResultError if one of the paths is a file that no export wrote, or that was changed since; of a folder, any file in it."""
        known = {name: digest for export in self.exports.values() for name, digest in export["files"].items()}
        for file in (file for path in paths for file in _files(path)):
            name = file.relative_to(self.folder).as_posix()
            if known.get(name) != _digest(file):
                kind = "was changed since an export wrote it" if name in known else "was not written by an export"
                raise ResultError(f"{file}: {kind}; choose another folder with --out, or replace it with --overwrite")

    def add(self, name: str, axes: Axes, paths: Sequence[Path]) -> None:
        """Notes the files of a format, and writes transform.json."""
        files = {file.relative_to(self.folder).as_posix(): _digest(file) for path in paths for file in _files(path)}
        self.exports[name] = {**_values(axes), "files": files}
        atomic_files.write_json(self.folder / RECORD, {**_values(self.axes), "exports": self.exports})


def _values(axes: Axes) -> dict[str, Any]:
    return {"up": axes.up, "T_export_world": axes.T_ew}


def _files(path: Path) -> list[Path]:
    """The path itself if it is a file, or the files below it; none if there is nothing."""
    return [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        digest = hashlib.sha256()
        while chunk := file.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest()
