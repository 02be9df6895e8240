"""Writes report.html, a single file that works without other files and without a network, its pictures to pictures/, and scene.html."""

import logging
from concurrent.futures import ThreadPoolExecutor, wait
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import trimesh

from idfslam.compute.devices import loops_may_overlap
from idfslam.config import PRESETS, RUN_SECTIONS, dump, read_yaml
from idfslam.datasets import Dataset
from idfslam.errors import IdfSlamError, ResultError
from idfslam.evaluation.evaluate import load_mesh
from idfslam.export.axes import Axes
from idfslam.export.memory_need import finest_cells
from idfslam.export.page import page_mesh, page_of
from idfslam.geometry.level import level
from idfslam.report.cards import cards_of
from idfslam.report.gallery import Gallery
from idfslam.report.known_error import KnownError
from idfslam.report.passages import passages
from idfslam.report.sections import charts, compared_frames, moving_images, room_pictures
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.metrics import read_metrics
from idfslam.runs.run_config import read_config
from idfslam.storage import atomic_files, output_folder
from idfslam.storage.ledger import Ledger

log = logging.getLogger(__name__)


def write_report(folder: Path, *, recording: Dataset | None = None, moved: Path | None = None, gt: Path | None = None) -> list[Path]:
    """Writes the report of a result folder. Returns the paths of the page, of scene.html if there is a mesh, and of the pictures.

    recording: the run's recording, if it is already open. moved: its path, if it is no longer the one in config.yaml.
    gt: file of the true trajectory, see `read_truth`; None: the recording's own.
    Sections are left out if the recording cannot be read, or if the run was interrupted or diverged before their data existed.
    Raises ResultError if the folder holds no trajectory, cannot be written to or is in use, or if another's file is in the report's place.
    """
    run = FinishedRun(folder, moved=moved)
    with output_folder.locked(folder):
        ledger, names = result_folder.ledger(folder), result_folder.report_files(folder)
        ledger.refuse_foreign(names)
        atomic_files.prepare(folder / result_folder.PICTURES)
        written = _write(run, ledger, recording=recording, gt=gt)
        ledger.remove(names - {path.relative_to(folder).as_posix() for path in written})  # last: a failure leaves the earlier report
        return written


def _write(run: FinishedRun, ledger: Ledger, *, recording: Dataset | None, gt: Path | None) -> list[Path]:
    folder, missing, gallery = run.folder, list[str](), Gallery(ledger)
    recording = _recording(run, missing) if recording is None else recording
    mesh = _mesh(folder, missing)
    error = KnownError.of(run, recording, gt)
    metrics = read_metrics(folder) if (folder / result_folder.METRICS).is_file() else {}
    upright = level(mesh, run.trajectory.poses)
    with ThreadPoolExecutor(1, "scene") as pool:  # its loops leave the interpreter to the charts, which are drawn meanwhile
        shown = None if mesh is None else pool.submit(page_mesh, run, mesh.copy())
        if shown is not None and not loops_may_overlap():
            wait([shown])
        sections = (
            charts(gallery, run, error, metrics)
            | room_pictures(gallery, run, error, mesh, upright.R_lw)
            | compared_frames(gallery, run, recording)
            | moving_images(gallery, run)
        )
    name = recording.name if recording is not None else folder.resolve().name
    if shown is not None:
        scene = page_of(run, shown.result(), Axes.upright(upright).gltf.T_ew, name=name, recording=recording)
        ledger.write_text(result_folder.SCENE, scene)
        gallery.written.append(folder / result_folder.SCENE)
    page = _template().render(
        name=name,
        made=datetime.fromtimestamp((folder / result_folder.TRAJECTORY).stat().st_mtime).strftime("%d %B %Y, %H:%M"),
        cards=cards_of(run, error, metrics, mesh),
        interrupted=bool(metrics.get("interrupted")),
        doubts=[str(doubt) for doubt in metrics.get("camera_doubts") or ()],
        passages=[] if run.frames is None else passages(run.frames, run.trajectory.poses),
        sections=sections,
        stages=sorted(metrics.get("ms_per_frame", {}).items(), key=lambda item: -item[1]),
        missing=missing,
        scene=result_folder.SCENE if mesh is not None else None,
        by_gravity=upright.by_gravity,
        finest=finest_cells(run.map) if (folder / result_folder.MAP).is_file() else None,
        config=_config(folder),
        extra=dict(zip(RUN_SECTIONS, _run_sections(folder))),
    )
    ledger.write_text(result_folder.REPORT, page)
    return [folder / result_folder.REPORT, *gallery.written]


def _template() -> jinja2.Template:
    text = files("idfslam.report").joinpath("template.html").read_text(encoding="utf-8")
    return jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined).from_string(text)


def _recording(run: FinishedRun, missing: list[str]) -> Dataset | None:
    """The recording; None if it cannot be read, with the reason in `missing`."""
    try:
        return run.recording
    except IdfSlamError as error:
        log.warning("report without the recording's images: %s", error)
        missing.append(f"Frames next to the rendered map: {error}.")
        return None


def _mesh(folder: Path, missing: list[str]) -> trimesh.Trimesh | None:
    """The mesh; None if there is none with triangles, with the reason in `missing`."""
    try:
        return load_mesh(result_folder.existing(folder, result_folder.MESH))
    except ResultError as error:
        missing.append(f"Mesh and map: {error}.")
        return None


def _run_sections(folder: Path) -> list[dict[str, Any]]:
    """The recording and the versions in config.yaml."""
    values = read_yaml(folder / result_folder.CONFIG) if (folder / result_folder.CONFIG).is_file() else {}
    return [values.get(name) or {} for name in RUN_SECTIONS]


def _config(folder: Path) -> list[tuple[str, list[tuple[str, Any, bool]]]]:
    """Sections of config.yaml: name, value, and whether it differs from the preset's."""
    if not (folder / result_folder.CONFIG).is_file():
        return []
    config, _ = read_config(folder)
    values, preset = dump(config), dump(PRESETS[config.preset])
    general = [(name, value, value != preset[name]) for name, value in values.items() if not isinstance(value, dict)]
    sections = [("general", general)]
    for name, section in values.items():
        if isinstance(section, dict):
            sections.append((name, [(key, value, value != preset[name].get(key)) for key, value in section.items()]))
    return sections
