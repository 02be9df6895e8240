"""The public sequences that can be downloaded, read from catalogue.yaml in this folder."""

from dataclasses import dataclass
from importlib.resources import files

import yaml

from idfslam.errors import DownloadError


@dataclass(frozen=True)
class Sequence:
    """An archive with one or more recordings."""

    name: str
    url: str
    folder: str  # its folder in the folder of downloads
    licence: str
    size_mb: int | None = None  # approximate size of the archive
    sha256: str | None = None  # of the archive, if its authors publish it
    run: tuple[str, ...] = (".",)  # paths of the recordings in the folder


def catalogue() -> dict[str, Sequence]:
    """All sequences by name."""
    values = yaml.safe_load(files("idfslam.downloads").joinpath("catalogue.yaml").read_text(encoding="utf-8"))
    sequences = {}
    for name, entry in values["sequences"].items():
        licence, run = values["licences"][entry["licence"]], tuple(entry.get("run", (".",)))
        sequences[name] = Sequence(name, **{**entry, "licence": licence, "run": run})
    return sequences


def find_sequence(name: str) -> Sequence:
    """The sequence of this name. Raises DownloadError, which suggests names, if there is none."""
    sequences = catalogue()
    if name not in sequences:
        near = [other for other in sequences if name.lower() in other] or list(sequences)
        raise DownloadError(
            f"{name}: not a known sequence, expected one such as {', '.join(near[:4])}; `idf-slam download --list` shows all"
        )
    return sequences[name]
