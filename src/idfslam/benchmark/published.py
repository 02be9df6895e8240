"""Figures that others have published for public sequences, with their sources (published.yaml)."""

import re
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from pathlib import PurePath
from typing import Any

import yaml

from idfslam.downloads.catalogue import catalogue

_SCANNET = re.compile(r"scene\d{4}_\d{2}")


@dataclass(frozen=True)
class PublishedFigure:
    """One figure of one method on one sequence."""

    sequence: str  # as in the catalogue, with /RECORDING where an archive holds several
    method: str
    metric: str  # with its unit, such as ate_rmse_cm
    title: str  # of the metric, in words
    value: float
    source: str
    url: str
    protocol: str | None = None  # of a surface, as in `eval --protocol`


@cache
def published_figures() -> tuple[PublishedFigure, ...]:
    """All of them, in the order of the file."""
    values = yaml.safe_load(files("idfslam.benchmark").joinpath("published.yaml").read_text(encoding="utf-8"))
    found = []
    for table in values["tables"]:
        source, metric = values["sources"][table["source"]], values["metrics"][table["metric"]]
        for method, row in table["figures"].items():
            for sequence, value in zip(table["sequences"], row, strict=True):
                if value is not None:
                    figure = sequence, method, table["metric"], metric["title"], float(value), source["title"], source["url"]
                    found.append(PublishedFigure(*figure, table.get("protocol")))
    return tuple(found)


def sequence_of(path: str) -> str | None:
    """The name of the public sequence that lies at a path, by its folders' names; None for any other recording."""
    parts = PurePath(path).parts
    if parts and _SCANNET.fullmatch(PurePath(parts[-1]).stem):
        return f"scannet/{PurePath(parts[-1]).stem}"
    for name, sequence in catalogue().items():
        for recording in sequence.run:
            folder = (PurePath(sequence.folder) / recording).parts
            if parts[-len(folder) :] == folder:
                return name if recording == "." else f"{name}/{recording}"
    return None


def published_for(path: str) -> list[dict[str, Any]]:
    """The figures of the sequence at a path, as values for JSON; none for a recording that is no public sequence."""
    name = sequence_of(path)
    return [asdict(figure) for figure in published_figures() if name is not None and figure.sequence == name]
