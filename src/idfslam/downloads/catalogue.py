"""The public sequences that can be downloaded; catalogue.yaml beside this file names them."""

from dataclasses import dataclass
from importlib.resources import files

import yaml

from idfslam.errors import DownloadError


@dataclass(frozen=True)
class Sequence:
    """One archive of recordings."""

    name: str
    url: str
    folder: str  # what it becomes in the folder of downloads
    licence: str
    size_mb: int | None = None  # of the archive, roughly
    sha256: str | None = None  # of the archive, where its authors state it
    run: tuple[str, ...] = (".",)  # the recordings in it


def catalogue() -> dict[str, Sequence]:
    """All sequences by their names."""
    values = yaml.safe_load(files("idfslam.downloads").joinpath("catalogue.yaml").read_text(encoding="utf-8"))
    found = {}
    for name, entry in values["sequences"].items():
        licence, run = values["licences"][entry["licence"]], tuple(entry.get("run", (".",)))
        found[name] = Sequence(name, **{**entry, "licence": licence, "run": run})
    return found


def named(name: str) -> Sequence:
    """One of them. Raises DownloadError for another name."""
    known = catalogue()
    if name not in known:
        near = [other for other in known if name.lower() in other] or list(known)
        raise DownloadError(
            f"{name}: not a known sequence, expected one such as {', '.join(near[:4])}; `idf-slam download --list` shows all"
        )
    return known[name]
