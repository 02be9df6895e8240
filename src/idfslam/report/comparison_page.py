"""Writes bench.html: our runs beside those of other systems, from the values of bench.json. A single file that needs no other."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup
from matplotlib.figure import Figure

from idfslam.report.chart import SERIES, Chart, chart, key
from idfslam.storage import output_folder
from idfslam.storage.ledger import Ledger

PAGE = "bench.html"


def write_comparison(folder: Path, results: Mapping[str, Any]) -> Path:
    """Writes the page of a benchmark with peers into its folder. Raises ResultError if another's file is in its place."""
    with output_folder.locked(folder):
        Ledger(folder).write_text(PAGE, comparison_page(results))
    return folder / PAGE


def comparison_page(results: Mapping[str, Any]) -> str:
    """The page as HTML."""
    recordings = results["recordings"]
    charts = [
        {
            "svg": Markup(drawn.svg),
            "caption": f"{r['name']}: ATE RMSE and speed; exact is low, fast is on the right",
        }  # safe: drawn by this program
        for number, r in enumerate(recordings)
        if (drawn := accuracy_against_speed(f"speed{number}", r["comparison"]["rows"])) is not None
    ]
    environment = jinja2.Environment(loader=jinja2.PackageLoader("idfslam.report", "."), autoescape=True, trim_blocks=True)
    return environment.get_template("comparison.html").render(
        peers=list(results["peers"]),
        preset=results["preset"],
        seeds=results["seeds"],
        rules=recordings[0]["comparison"]["rules"] if recordings else "",
        wins=_wins(recordings),
        charts=charts,
        recordings=[_section(r) for r in recordings],
        methods=_methods(results),
        machine=machine_line(results["machine"]),
    )


def machine_line(machine: Mapping[str, Any]) -> str:
    """The machine and the versions in a line."""
    gpu = f", {machine['gpu']}" if machine.get("gpu") else ""
    versions = ", ".join(f"{name} {machine[name]}" for name in ("idf-slam", "python", "torch") if name in machine)
    return f"{machine['processor']}, {machine['cores']} cores{gpu}; {machine.get('system', 'unknown system')}; {versions}"


def accuracy_against_speed(name: str, rows: Sequence[Mapping[str, Any]]) -> Chart | None:
    """A point for each method: frames a second and ATE, both on logarithmic axes. None if no method has both."""
    points = [
        (row["method"], row["summary"]["frames_per_second"]["mean"], row["summary"]["ate_m"]["mean"] * 100)
        for row in rows
        if {"frames_per_second", "ate_m"} <= row["summary"].keys() and row["summary"]["ate_m"]["mean"] > 0
    ]
    if not points:
        return None

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for (method, speed, error), colour in zip(points, SERIES):
            axes.plot([speed], [error], "o", color=colour, markersize=9, label=method)
        axes.set(xscale="log", yscale="log", xlabel="frames/s", ylabel="ATE RMSE [cm]")
        for axis, values in ((axes.xaxis, [p[1] for p in points]), (axes.yaxis, [p[2] for p in points])):
            low, high = min(values) / 1.5, max(values) * 1.5
            axis.set_ticks(_ticks(low, high), minor=False)
            axis.set_major_formatter(lambda value, _: f"{value:g}")
            axis.set_minor_formatter("")
            (axes.set_xlim if axis is axes.xaxis else axes.set_ylim)(low, high)
        key(axes)

    return chart(name, 3.2, draw)


def _ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 of each power of ten within the limits."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    return [m * 10.0**p for p in powers for m in (1, 2, 5) if low <= m * 10.0**p <= high]


def _wins(recordings: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """The winner of each column for each recording; None if nothing was compared."""
    columns = [
        c for r in recordings[:1] for c in r["comparison"]["columns"] if any(c["key"] in s["comparison"]["winners"] for s in recordings)
    ]
    if not columns:
        return None
    rows = [{"name": r["name"], "cells": [r["comparison"]["winners"].get(c["key"], "-") for c in columns]} for r in recordings]
    return {"titles": [c["title"].split(" [")[0] for c in columns], "rows": rows}


def _section(recording: Mapping[str, Any]) -> dict[str, Any]:
    found = recording["comparison"]
    used = [c for c in found["columns"] if any(c["key"] in row["summary"] for row in found["rows"])]
    rows = [
        {
            "method": row["method"],
            "runs": f"{row['finished']} of {row['runs']}",
            "cells": [_cell(row, column, found["winners"]) for column in used],
        }
        for row in found["rows"]
    ]
    notes = [f"{row['method']}: {row['note']}" for row in found["rows"] if row["note"]]
    return {
        "name": recording["name"],
        "titles": [c["title"] for c in used],
        "rows": rows,
        "notes": notes,
        "published": recording["published"],
    }


def _cell(row: Mapping[str, Any], column: Mapping[str, Any], winners: Mapping[str, str]) -> dict[str, Any]:
    spread = row["summary"].get(column["key"])
    if spread is None:
        return {"text": "-", "best": False, "small": ""}
    unit, digits, best = column["unit"], column["digits"], winners.get(column["key"]) == row["method"]
    text = f"{spread['mean'] * unit:.{digits}f}"
    if spread["deviation"] is not None:
        text += f" ± {spread['deviation'] * unit:.{digits}f}"
    if column["key"] in ("ate_m", "frames_per_second") and column["key"] in row["ratios"] and row["ratios"][column["key"]] != 1:
        return {"text": text, "best": best, "small": f"{row['ratios'][column['key']]:.2f} times ours"}
    return {"text": text, "best": best, "small": ""}


def _methods(results: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Name, description and version of each method."""
    versions = {row["method"]: row["version"] for r in results["recordings"] for row in r["comparison"]["rows"] if row.get("version")}
    ours = ("idf-slam", f"this program, preset {results['preset']}", str(results["machine"]["idf-slam"]))
    return [ours, *((name, peer["about"], versions.get(name) or "not run") for name, peer in results["peers"].items())]
