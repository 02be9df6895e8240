"""Writes reproduce.html and reproduce.md: the paper's tables from the rows of reproduce.json, with meshes and matches."""

import base64
import io
import logging
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import trimesh
from markupsafe import Markup
from PIL import Image

from idfslam.datasets import Dataset, open_recording
from idfslam.errors import IdfSlamError, ResultError
from idfslam.evaluation.evaluate import load_mesh
from idfslam.evaluation.trajectory_error import first_pose_alignment
from idfslam.geometry.camera import Camera
from idfslam.geometry.level import up_direction
from idfslam.pictures.direction import best_direction
from idfslam.pictures.mesh_renderer import Picture, Shading, pose_outside
from idfslam.pictures.scraps import without_scraps
from idfslam.report.comparison_page import machine_line
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.storage import output_folder
from idfslam.storage.ledger import Ledger

log = logging.getLogger(__name__)

PAGE, TABLE, MATCHES = "reproduce.html", "reproduce.md", "matches.png"
_CAMERA = Camera(480, 360, 600.0, 600.0, 239.5, 179.5)
_QUALITY = 82  # of the pictures on the page (WebP, 0 to 100); larger: a larger page
_LESS = ("ate_rmse_cm", "ate_mean_cm", "ate_median_cm", "accuracy_cm", "completion_cm", "seconds")  # less is better
_TITLES = {
    "accuracy_cm": "Acc. [cm]",
    "completion_cm": "Comp. [cm]",
    "completion_ratio_percent": "Ratio < 5 cm [%]",
    "ate_rmse_cm": "ATE RMSE [cm]",
    "ate_mean_cm": "ATE mean [cm]",
    "ate_median_cm": "ATE median [cm]",
}
_SURFACE = ("accuracy_cm", "completion_cm", "completion_ratio_percent")
_POSES = ("ate_rmse_cm", "ate_mean_cm", "ate_median_cm")


def write_reproduction(folder: Path, results: Mapping[str, Any], *, total: int) -> None:
    """Writes page and table into the folder of the rows. total: runs of the suite. Raises ResultError for another's files there."""
    tables = tables_of(results)
    page = reproduction_page(results, tables, total=total, meshes=_meshes(folder, results["rows"]), matches=_matches(folder))
    with output_folder.locked(folder):
        ledger = Ledger(folder)
        with ledger.replacing(PAGE) as part:
            part.write_text(page, encoding="utf-8")
        with ledger.replacing(TABLE) as part:
            part.write_text(markdown(results, tables), encoding="utf-8")


def reproduction_page(
    results: Mapping[str, Any],
    tables: Sequence[Mapping[str, Any]],
    *,
    total: int,
    meshes: Sequence[Mapping[str, Any]] = (),
    matches: Markup | None = None,
) -> str:
    """The page as HTML."""
    rows = results["rows"]
    environment = jinja2.Environment(loader=jinja2.PackageLoader("idfslam.report", "."), autoescape=True, trim_blocks=True)
    return environment.get_template("reproduction.html").render(
        finished=sum("failed" not in row for row in rows),
        total=total,
        seed=results["seed"],
        protocol=results["protocol"],
        methods={row["method"] for row in rows},
        notes=results["notes"],
        tables=tables,
        meshes=meshes,
        matches=matches,
        failed=[f"{row['name']}: {row['failed']}" for row in rows if "failed" in row],
        machine=machine_line(results["machine"]),
        workers=results["workers"],
    )


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


def tables_of(results: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The paper's three tables, time and memory, and the ablations, as far as there are rows; each with titles and rows of cells."""
    done = [row for row in results["rows"] if "failed" not in row]
    rooms = [row for row in done if row["table"] == "reconstruction"]
    scenes = [row for row in done if row["table"] == "tracking"]
    parts = [row for row in done if row["table"] == "ablation"]
    printed = results["printed"]
    tables = [
        _scenes(
            "reconstruction",
            "Table I: reconstruction",
            "Less is better but for the ratio. The means of printed rows are over the paper's eight scenes.",
            rooms,
            printed,
            _SURFACE,
        ),
        _scenes(
            "tracking",
            "Table II: camera tracking",
            "Errors after rigid alignment of all frames. The means of printed rows are over the paper's eight scenes.",
            rooms,
            printed,
            _POSES,
        ),
        _scenes(
            "scannet",
            "Table III: camera tracking with a real or a noisy sensor",
            "The paper's is of six scenes of ScanNet, over which the means of printed rows are.",
            scenes,
            printed,
            _POSES[:1],
        ),
        _cost(rooms + scenes),
        _ablation(parts),
    ]
    return [table for table in tables if table["rows"]]


def _scenes(
    name: str, title: str, about: str, rows: Sequence[Mapping[str, Any]], printed: Sequence[Mapping[str, Any]], metrics: Sequence[str]
) -> dict[str, Any]:
    """A table with a column for each scene and their mean, and a line for each method and metric.

    Printed rows stand in the columns of their sequences; where no scene is one of them, their means alone are shown.
    """
    names = list(dict.fromkeys(row["scene"] for row in rows))
    sequences = {row["scene"]: row["sequence"] for row in rows}
    found = {(row["method"], row["scene"], metric): row[metric] for row in rows for metric in metrics if metric in row}
    table = "tracking" if name == "scannet" else "reconstruction"
    of_paper = [f for f in printed if f["table"] == table and f["metric"] in metrics]
    lines = [
        _line(method, metric, [found.get((method, scene, metric)) for scene in names])
        for method in dict.fromkeys(row["method"] for row in rows)
        for metric in metrics
    ]
    _mark_best(lines, metrics)
    for method in dict.fromkeys(f["method"] for f in of_paper if rows):
        for metric in metrics:
            values = {f["sequence"]: f["value"] for f in of_paper if (f["method"], f["metric"]) == (method, metric)}
            if values:
                known = [values.get(str(sequences[scene])) for scene in names]
                lines.append(_line(f"{method}, printed", metric, known, mean=statistics.fmean(values.values()), printed=True))
    rows_ = [{"cells": line["cells"], "printed": line["printed"]} for line in lines]
    return {"id": name, "title": title, "about": about, "titles": ["method", "metric", *names, "mean"], "rows": rows_}


def _line(method: str, metric: str, values: Sequence[float | None], *, mean: float | None = None, printed: bool = False) -> dict[str, Any]:
    known = [value for value in values if value is not None]
    all_ = [*values, mean if mean is not None else statistics.fmean(known) if known else None]
    cells = [_cell(method), _cell(_TITLES[metric]), *(_cell("-" if v is None else f"{v:.2f}") for v in all_)]
    return {"metric": metric, "values": all_, "cells": cells, "printed": printed}


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
        cells = [method, f"{speed:.2f}", f"{2000 / speed / 3600:.2f}", f"{max(memory):.0f}" if memory else "-"]
        cells += [f"{max(gpu):.0f}" if gpu else "-", f"{sum(row['lost_frames'] for row in own)} of {sum(row['processed'] for row in own)}"]
        cells += [f"{statistics.fmean(row['keyframes'] for row in own):.1f}"]
        lines.append({"cells": [_cell(text) for text in cells], "printed": False})
    if lines:
        lines.append({"cells": [_cell(t) for t in ("iDF-SLAM, printed", "-", "about 7", "-", "about 4000", "-", "-")], "printed": True})
        lines.append({"cells": [_cell(t) for t in ("iMAP, printed", "-", "about 12", "-", "-", "-", "-")], "printed": True})
    about = (
        "Means over the scenes, largest memory. The paper's hours are those of a GeForce RTX 2080 Ti; ours are extrapolated from the speed."
    )
    titles = ["method", "frames/s", "hours for 2000 frames", "memory [MiB]", "GPU memory [MiB]", "lost frames", "keyframes"]
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


def _meshes(folder: Path, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The surfaces of each scene side by side: the true one, where it is known, and that of each method."""
    shown = [row for row in rows if "failed" not in row and row["table"] == "reconstruction"]
    scenes = [(name, [row for row in shown if row["scene"] == name]) for name in dict.fromkeys(row["scene"] for row in shown)]
    return [{"name": name, "figures": figures} for name, own in scenes if (figures := _of_scene(folder, own))]


def _of_scene(folder: Path, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """From where all reconstructions together are seen best: short recordings show a part of the true surface only."""
    found = dict[str, trimesh.Trimesh]()
    recording = open_recording(rows[0]["path"], frames=rows[0]["frames"], stride=rows[0]["stride"], report=False)
    for row in rows:
        try:
            found[row["method"]] = without_scraps(_mesh_in_truth(folder / row["name"], recording))
        except IdfSlamError as error:
            log.warning("%s: no picture of its mesh (%s)", row["name"], error)
    if not found:
        return []
    poses, whole = _true_poses(recording), trimesh.util.concatenate(list(found.values()))
    assert isinstance(whole, trimesh.Trimesh)
    up, eyes = up_direction(whole, poses), poses[:, :3, 3]
    T_wo = pose_outside(whole, up, best_direction(whole, eyes, up), _CAMERA)
    surfaces = found if (truth := _true_surface(rows[0], recording)) is None else {"truth": without_scraps(truth)} | found
    pictures = {name: Picture(mesh, inside=eyes).draw(T_wo, _CAMERA, Shading()) for name, mesh in surfaces.items()}
    return [{"image": _image(picture), "caption": name} for name, picture in pictures.items()]


def _true_surface(row: Mapping[str, Any], recording: Dataset) -> trimesh.Trimesh | None:
    return load_mesh(Path(row["gt_mesh"])) if row.get("gt_mesh") else recording.surface()


def _true_poses(recording: Dataset) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(N, 4, 4) those that are known. Raises ResultError if none is."""
    if recording.ground_truth is None:
        raise ResultError(f"{recording.name}: has no true poses")
    return recording.ground_truth[np.isfinite(recording.ground_truth).all((1, 2))]


def _mesh_in_truth(folder: Path, recording: Dataset) -> trimesh.Trimesh:
    """The mesh of a run, placed as the protocol of the tables places it."""
    _true_poses(recording)
    assert recording.ground_truth is not None
    T_gt_est = first_pose_alignment(FinishedRun(folder).trajectory.poses, recording.ground_truth)
    return load_mesh(folder / result_folder.MESH).apply_transform(T_gt_est)


def _matches(folder: Path) -> Markup | None:
    path = folder / MATCHES
    return _image(np.asarray(Image.open(path).convert("RGB"))) if path.is_file() else None


def _image(pixels: np.ndarray[Any, np.dtype[np.uint8]]) -> Markup:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "WEBP", quality=_QUALITY)
    data = base64.b64encode(file.getvalue()).decode()
    return Markup('<img src="data:image/webp;base64,{}" width="{}" height="{}" alt="">').format(data, pixels.shape[1], pixels.shape[0])
