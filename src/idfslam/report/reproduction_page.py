"""Writes reproduce.html and reproduce.md: the paper's tables, with pictures of meshes and matches."""

import logging
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
from idfslam.pictures.mesh_renderer import Lighting, Picture, pose_outside
from idfslam.pictures.scraps import without_scraps
from idfslam.report.comparison_page import machine_line
from idfslam.report.gallery import image_element
from idfslam.report.reproduction_tables import markdown, tables_of
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.storage import output_folder
from idfslam.storage.ledger import Ledger

log = logging.getLogger(__name__)

PAGE, TABLE, MATCHES = "reproduce.html", "reproduce.md", "matches.png"
_CAMERA = Camera(480, 360, 600.0, 600.0, 239.5, 179.5)


def write_reproduction(folder: Path, results: Mapping[str, Any], *, total: int) -> None:
    """Writes page and table into the folder of the rows. total: runs of the suite. Raises ResultError for another's files there."""
    tables = tables_of(results)
    page = reproduction_page(results, tables, total=total, meshes=_meshes(folder, results["rows"]), matches=_matches(folder))
    with output_folder.locked(folder):
        ledger = Ledger(folder)
        ledger.write_text(PAGE, page)
        ledger.write_text(TABLE, markdown(results, tables))


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
    pictures = {name: Picture(mesh, inside=eyes).draw(T_wo, _CAMERA, Lighting()) for name, mesh in surfaces.items()}
    return [{"image": image_element(picture), "caption": name} for name, picture in pictures.items()]


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
    return image_element(np.asarray(Image.open(path).convert("RGB"))) if path.is_file() else None
