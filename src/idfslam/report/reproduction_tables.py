"""The tables of a reproduction: the paper's own figures beside those measured, from the rows of reproduce.json."""

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

_LESS = ("ate_rmse_cm", "ate_mean_cm", "ate_median_cm", "accuracy_cm", "completion_cm", "seconds")  # less is better
_TITLES = {
    "accuracy_cm": "Acc. [cm]",
    "completion_cm": "Comp. [cm]",
    "completion_ratio_percent": "Ratio < 5 cm [%]",
    "ate_rmse_cm": "ATE RMSE [cm]",
    "ate_mean_cm": "ATE mean [cm]",
    "ate_median_cm": "ATE median [cm]",
}
_LONG = 2000  # frames of a sequence of Replica, whose hours the paper prints: a fact
_SURFACE = ("accuracy_cm", "completion_cm", "completion_ratio_percent")
_POSES = ("ate_rmse_cm", "ate_mean_cm", "ate_median_cm")


@dataclass(frozen=True)
class _PaperTable:
    """One of the paper's tables. rows: which rows of reproduce.json are its, measured and printed ones, by their `table`."""

    id: str
    title: str
    about: str
    rows: str
    metrics: Sequence[str]


_PAPER_TABLES = (
    _PaperTable(
        "reconstruction",
        "Table I: reconstruction",
        "Less is better but for the ratio. The means of printed rows are over the paper's eight scenes.",
        "reconstruction",
        _SURFACE,
    ),
    _PaperTable(
        "tracking",
        "Table II: camera tracking",
        "Errors after rigid alignment of all frames. The means of printed rows are over the paper's eight scenes.",
        "reconstruction",
        _POSES,
    ),
    _PaperTable(
        "scannet",
        "Table III: camera tracking with a real or a noisy sensor",
        "The paper's is of six scenes of ScanNet, over which the means of printed rows are.",
        "tracking",
        _POSES[:1],
    ),
)


def tables_of(results: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The paper's three tables, time and memory, and the ablations, as far as there are rows; each with titles and rows of cells."""
    done = [row for row in results["rows"] if "failed" not in row]
    tables = [_scenes(table, done, results["printed"]) for table in _PAPER_TABLES]
    tables.append(_cost([row for kind in ("reconstruction", "tracking") for row in done if row["table"] == kind]))
    tables.append(_ablation([row for row in done if row["table"] == "ablation"]))
    return [table for table in tables if table["rows"]]


def _scenes(table: _PaperTable, measured: Sequence[Mapping[str, Any]], printed: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """A table with a column for each scene and their mean, and a line for each method and metric.

    Printed rows stand in the columns of their sequences; where no scene is one of them, their means alone are shown.
    """
    rows = [row for row in measured if row["table"] == table.rows]
    scenes = {row["scene"]: row["sequence"] for row in rows}
    values = {(row["method"], row["scene"], metric): row[metric] for row in rows for metric in table.metrics if metric in row}
    lines = [
        _line(method, metric, [values.get((method, scene, metric)) for scene in scenes])
        for method in dict.fromkeys(row["method"] for row in rows)
        for metric in table.metrics
    ]
    _mark_best(lines, table.metrics)
    lines += _printed_lines(table, list(scenes.values()), printed) if rows else []
    cells = [{"cells": line["cells"], "printed": line["printed"]} for line in lines]
    return {"id": table.id, "title": table.title, "about": table.about, "titles": ["method", "metric", *scenes, "mean"], "rows": cells}


def _printed_lines(table: _PaperTable, sequences: Sequence[Any], printed: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The lines of what the paper prints. sequences: those of the table's columns."""
    of_paper = [figure for figure in printed if figure["table"] == table.rows and figure["metric"] in table.metrics]
    lines = []
    for method in dict.fromkeys(figure["method"] for figure in of_paper):
        for metric in table.metrics:
            values = {f["sequence"]: f["value"] for f in of_paper if (f["method"], f["metric"]) == (method, metric)}
            if values:
                known = [values.get(str(sequence)) for sequence in sequences]
                lines.append(_line(f"{method}, printed", metric, known, mean=statistics.fmean(values.values()), printed=True))
    return lines


def _line(method: str, metric: str, values: Sequence[float | None], *, mean: float | None = None, printed: bool = False) -> dict[str, Any]:
    """A line of the table. mean: of the values; None: worked out."""
    known = [value for value in values if value is not None]
    shown = [*values, mean if mean is not None else statistics.fmean(known) if known else None]
    cells = [_cell(method), _cell(_TITLES[metric]), *(_cell("-" if v is None else f"{v:.2f}") for v in shown)]
    return {"metric": metric, "values": shown, "cells": cells, "printed": printed}


def _cell(text: str) -> dict[str, Any]:
    return {"text": text, "best": False}


def _mark_best(lines: Sequence[dict[str, Any]], metrics: Sequence[str]) -> None:
    """Marks the best measured value of each metric in each column."""
    for metric in metrics:
        same = [line for line in lines if line["metric"] == metric]
        for column in range(len(same[0]["values"]) if len(same) > 1 else 0):
            having = [line for line in same if line["values"][column] is not None]
            sign = 1 if metric in _LESS else -1
            if len(having) > 1:
                best = min(having, key=lambda line: sign * line["values"][column])
                best["cells"][column + 2]["best"] = True


def _cost(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Time and memory of each method, means over the scenes."""
    lines = []
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        speed = statistics.fmean(row["frames_per_second"] for row in own)
        memory, gpu = ([row[key] for row in own if row.get(key)] for key in ("peak_memory_mb", "peak_gpu_memory_mb"))
        cells = [method, f"{speed:.2f}", f"{_LONG / speed / 3600:.2f}", f"{max(memory):.0f}" if memory else "-"]
        cells += [f"{max(gpu):.0f}" if gpu else "-", f"{sum(row['lost_frames'] for row in own)} of {sum(row['processed'] for row in own)}"]
        cells += [f"{statistics.fmean(row['keyframes'] for row in own):.1f}"]
        lines.append({"cells": [_cell(text) for text in cells], "printed": False})
    if lines:
        lines.append({"cells": [_cell(t) for t in ("iDF-SLAM, printed", "-", "about 7", "-", "about 4000", "-", "-")], "printed": True})
        lines.append({"cells": [_cell(t) for t in ("iMAP, printed", "-", "about 12", "-", "-", "-", "-")], "printed": True})
    about = (
        "Means over the scenes, largest memory. The paper's hours are those of a GeForce RTX 2080 Ti; ours are extrapolated from the speed."
    )
    titles = ["method", "frames/s", f"hours for {_LONG} frames", "memory [MiB]", "GPU memory [MiB]", "lost frames", "keyframes"]
    return {"id": "cost", "title": "Time and memory", "about": about, "titles": titles, "rows": lines}


def _ablation(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The full system and it with one part left out."""
    keys = [key for key in ("ate_rmse_cm", *_SURFACE) if any(key in row for row in rows)]
    lines = []
    for row in rows:
        counts = [str(row[key]) for key in ("keyframes", "finetuning_steps", "lost_frames")] + [f"{row['seconds']:.0f}"]
        cells = [row["variant"], *(f"{row[key]:.2f}" if key in row else "-" for key in keys), *counts]
        lines.append({"cells": [_cell(text) for text in cells], "printed": False})
    where = f"{rows[0]['path']}, every {rows[0]['stride']}th frame" if rows and rows[0]["stride"] > 1 else rows[0]["path"] if rows else ""
    about = f"The paper's preset on {where}, one seed: differences of a few millimetres are within what another seed changes."
    titles = ["run", *(_TITLES[key] for key in keys), "keyframes", "finetuning steps", "lost", "seconds"]
    return {"id": "ablation", "title": "One part left out at a time", "about": about, "titles": titles, "rows": lines}


def markdown(results: Mapping[str, Any], tables: Sequence[Mapping[str, Any]]) -> str:
    """The tables as Markdown; rows that the paper prints are in italics."""
    parts = [*results["notes"]]
    for table in tables:
        lines = [table["titles"], ["---", *["---:"] * (len(table["titles"]) - 1)]]
        for row in table["rows"]:
            mark = "*" if row["printed"] else ""
            texts = [cell["text"].replace("*", r"\*") for cell in row["cells"]]  # iMAP* has one of its own
            lines.append([f"{mark}{text}{mark}" if text else "" for text in texts])
        parts += [f"{table['title']}. {table['about']}", "\n".join("| " + " | ".join(line) + " |" for line in lines)]
    parts += [f"Failed: {row['name']}: {row['failed']}" for row in results["rows"] if "failed" in row]
    return "\n\n".join(parts) + "\n"
