"""Writes report.html, a single file that works without other files and without a network, its pictures to pictures/, and scene.html."""

import base64
import io
import logging
from dataclasses import dataclass, field
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import trimesh
from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image

from idfslam.config import PRESETS, RUN_SECTIONS, dump, read_yaml
from idfslam.datasets import Dataset
from idfslam.errors import IdfSlamError, ResultError
from idfslam.evaluation.evaluate import evaluate_poses, load_mesh
from idfslam.evaluation.trajectory_error import AbsoluteTrajectoryError, absolute_trajectory_error, matched_ground_truth
from idfslam.evaluation.truth_file import read_truth
from idfslam.export.axes import Axes
from idfslam.export.memory_need import finest_cells
from idfslam.export.page import page_of
from idfslam.geometry.level import level
from idfslam.report import figures
from idfslam.report.chart import Chart
from idfslam.report.passages import passages
from idfslam.report.views import Room, comparisons, moving_strip
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.metrics import read_metrics
from idfslam.runs.run_config import read_config
from idfslam.storage import atomic_files, output_folder
from idfslam.storage.json_file import read_json
from idfslam.storage.ledger import Ledger
from idfslam.storage.plain_values import shown

log = logging.getLogger(__name__)

_QUALITY = 82  # of the pictures on the page (WebP, 0 to 100); larger: a larger page


@dataclass
class _Figure:
    """A picture or chart on the page, with its caption."""

    content: Markup
    caption: str


@dataclass
class _Gallery:
    """Collects the pictures of the page and writes them as files, too."""

    ledger: Ledger
    written: list[Path] = field(default_factory=list)

    def chart(self, name: str, caption: str, chart: Chart | None) -> list[_Figure]:
        """A figure of the chart; empty for None."""
        if chart is None:
            return []
        self._write(name, chart.png)
        return [_Figure(Markup(chart.svg), caption)]  # safe: drawn by this program

    def picture(self, name: str, caption: str, image: NDArray[np.uint8]) -> _Figure:
        """A figure of an image (H, W, 3) or (H, W, 4)."""
        page, file = io.BytesIO(), io.BytesIO()
        Image.fromarray(image).save(page, "WEBP", quality=_QUALITY)
        Image.fromarray(image).save(file, "PNG")
        self._write(name, file.getvalue())
        data = base64.b64encode(page.getvalue()).decode()
        size = Markup('width="{}" height="{}"').format(image.shape[1], image.shape[0])
        return _Figure(Markup('<img src="data:image/webp;base64,{}" {} alt="{}">').format(data, size, caption), caption)

    def _write(self, name: str, data: bytes) -> None:
        name = f"{result_folder.PICTURES}/{name}.png"
        with self.ledger.replacing(name) as part:
            part.write_bytes(data)
        self.written.append(self.ledger.folder / name)


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
    folder, missing = run.folder, list[str]()
    if recording is None:
        recording = _recording(run, missing)
    gallery = _Gallery(ledger)
    mesh = _mesh(folder, missing)
    ate = _ate(run, recording, gt)
    metrics = read_metrics(folder) if (folder / result_folder.METRICS).is_file() else {}
    upright = level(mesh, run.trajectory.poses)
    sections = (
        _charts(gallery, run, ate, metrics)
        | _room(gallery, run, ate, mesh, upright.R_lw)
        | _frames(gallery, run, recording)
        | _moving(gallery, run)
    )
    name = recording.name if recording is not None else folder.resolve().name
    if mesh is not None:
        T_lw = np.eye(4)
        T_lw[:3, :3] = upright.R_lw
        scene = page_of(run, mesh, Axes("z", T_lw, upright.by_gravity).gltf.T_ew, name=name, recording=recording)
        with ledger.replacing(result_folder.SCENE) as part:
            part.write_text(scene, encoding="utf-8")
        gallery.written.append(folder / result_folder.SCENE)
    page = _template().render(
        name=name,
        made=datetime.fromtimestamp((folder / result_folder.TRAJECTORY).stat().st_mtime).strftime("%d %B %Y, %H:%M"),
        cards=_cards(run, ate, metrics, mesh),
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
    with ledger.replacing(result_folder.REPORT) as part:
        part.write_text(page, encoding="utf-8")
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


def _ate(run: FinishedRun, recording: Dataset | None, gt: Path | None) -> tuple[AbsoluteTrajectoryError, NDArray[np.float64]] | None:
    """The absolute trajectory error and the truth (N, 4, 4), NaN where it is unknown; None without any truth."""
    if gt is not None:
        truth = matched_ground_truth(run.trajectory, read_truth(gt, run.trajectory))
    elif recording is not None and recording.ground_truth is not None:
        truth = recording.ground_truth[: len(run.trajectory)]
    else:
        return None
    return (absolute_trajectory_error(run.trajectory.poses, truth), truth) if np.isfinite(truth).all((1, 2)).any() else None


Error = tuple[AbsoluteTrajectoryError, NDArray[np.float64]] | None


def _charts(gallery: _Gallery, run: FinishedRun, error: Error, metrics: dict[str, Any]) -> dict[str, list[_Figure]]:
    """The charts over time, and the bars of the stages."""
    stamps, errors, times, losses = run.trajectory.timestamps, [], [], []
    if error is not None:
        per_frame = np.full(len(stamps), np.nan)
        per_frame[error[0].frames] = error[0].errors
        chart = figures.error_chart(stamps - stamps[0], per_frame, error[0].translation.rmse)
        errors = gallery.chart("error", "Distance between estimated and true position, trajectories aligned", chart)
    if run.frames is not None and run.frames.lines:
        times = gallery.chart(
            "frames", "Time of each frame, keyframes, and frames whose pose is in doubt", figures.frames_chart(run.frames)
        )
        losses = gallery.chart("losses", "Losses of the map and of the tracker's finetuning", figures.losses_chart(run.frames))
    stages = metrics.get("ms_per_frame")
    background = "; the map learns in the background" if "wait" in (stages or {}) else ""
    bars = gallery.chart("stages", f"Time of each stage{background}", figures.stages_chart(stages)) if stages else []
    return {"error": errors, "frames": times, "stages": bars, "losses": losses}


def _room(
    gallery: _Gallery, run: FinishedRun, error: Error, mesh: trimesh.Trimesh | None, R_lw: NDArray[np.float64]
) -> dict[str, list[_Figure]]:
    """The trajectory, the mesh and slices of the map, in level coordinates."""
    poses = run.trajectory.poses
    truth = None
    if error is not None:
        T_est_gt = np.linalg.inv(error[0].T_gt_est)
        truth = (error[1][:, :3, 3] @ T_est_gt[:3, :3].T + T_est_gt[:3, 3]) @ R_lw.T
    path = figures.Path(poses[:, :3, 3] @ R_lw.T, truth, run.keyframes.indices)
    room = Room(mesh, poses, R_lw) if mesh is not None else None
    plan = None if room is None else room.plan()
    sections = {
        "trajectory": [
            *gallery.chart("trajectory_top", "From above: circle start, square end", figures.trajectory_chart(path, (0, 1), plan)),
            *gallery.chart("trajectory_side", "From the side: x and height", figures.trajectory_chart(path, (0, 2))),
            *gallery.chart("trajectory_front", "From the side: y and height", figures.trajectory_chart(path, (1, 2))),
        ],
        "mesh": [],
        "inside": [],
        "slices": [],
    }
    if room is not None:
        sections["mesh"] = [gallery.picture(f"mesh_{i}", f"From outside, side {i}", image) for i, image in enumerate(room.outside(), 1)]
        sections["inside"] = [gallery.picture(f"inside_{i}", f"From inside, place {i}", image) for i, image in enumerate(room.inside(), 1)]
    if room is not None and (run.folder / result_folder.MAP).is_file():
        for i, (height, plane) in enumerate(room.slices(run.map), 1):
            drawn = figures.slice_chart(f"slice{i}", plane, path, run.map.field.config.truncation)
            sections["slices"] += gallery.chart(f"slice_{i}", f"{height:.2f} m above the lowest surface", drawn)
    return sections


def _frames(gallery: _Gallery, run: FinishedRun, recording: Dataset | None) -> dict[str, Any]:
    """Frames next to the map rendered from their estimated poses."""
    if recording is None or not (run.folder / result_folder.MAP).is_file():
        return {"views": []}
    rows = []
    for n, comparison in enumerate(comparisons(run.views, recording, run.trajectory.poses), 1):
        shown = [
            gallery.picture(f"view_{n}_{caption.replace(', ', '_').replace(' ', '_')}", caption, image)
            for caption, image in comparison.pictures.items()
        ]
        figures = f"PSNR {comparison.psnr:.1f} dB at its exposure, median depth error {comparison.depth_error * 100:.1f} cm"
        text = f"Frame {comparison.index}: {figures}"
        rows.append((text, shown))
    return {"views": rows}


def _moving(gallery: _Gallery, run: FinishedRun) -> dict[str, list[_Figure]]:
    """Images in which something moves."""
    strip = [] if run.archive is None else moving_strip(run.archive)
    return {"moving": [gallery.picture(f"moving_{n}", caption, image) for n, (caption, image) in enumerate(strip, 1)]}


def _measured(run: FinishedRun, truth: NDArray[np.float64]) -> list[tuple[str, str, str]]:
    """The card of the error over the frames whose pose was measured; none where these are all frames, or unknown."""
    if run.measured.all():
        return []
    errors = evaluate_poses(run.trajectory.poses, truth, measured=run.measured).measured
    return [] if errors is None else [("ATE, measured", f"{errors.ate.translation.rmse * 100:.2f}", f"cm, {errors.frames} measured poses")]


def _cards(run: FinishedRun, error: Error, metrics: dict[str, Any], mesh: trimesh.Trimesh | None) -> list[tuple[str, str, str]]:
    """The cards at the top of the page: label, value, unit or remark."""
    path = np.linalg.norm(np.diff(run.trajectory.positions, axis=0), axis=-1).sum()
    stamps = run.trajectory.timestamps
    cards = [("frames", f"{len(stamps)}", f"{stamps[-1] - stamps[0]:.1f} s, {path:.1f} m of path")]
    if "frames_per_second" in metrics:
        cards.append(("speed", f"{metrics['frames_per_second']:.1f}", f"frames/s, {metrics['seconds']:.0f} s in all"))
    if error is not None:
        s = error[0].translation
        cards.append(("ATE RMSE", f"{s.rmse * 100:.2f}", f"cm, largest {s.max * 100:.2f} cm"))
        cards += _measured(run, error[1])
    if "lost_frames" in metrics:
        others = f"and {metrics.get('degenerate_frames', 0)} degenerate, {metrics.get('doubtful_frames', 0)} doubtful"
        cards.append(("lost frames", f"{metrics['lost_frames']}", others))
    if metrics.get("submaps", 1) > 1:
        cards.append(("submaps apart", f"{metrics['submaps'] - 1}", "never met the first one, and are left out"))
    cards.append(("keyframes", f"{len(run.keyframes.indices)}", f"{run.keyframes.camera.width} x {run.keyframes.camera.height} px"))
    if mesh is not None:
        cards.append(("mesh", f"{mesh.area:.0f}", f"m² in {len(mesh.faces) / 1000:.0f} k triangles"))
    if (run.folder / result_folder.MAP).is_file():
        cards.append(("map", f"{(run.folder / result_folder.MAP).stat().st_size / 1e6:.1f}", "MB on disk"))
    if metrics.get("peak_memory_mb") is not None:
        cards.append(("memory", f"{metrics['peak_memory_mb']:.0f}", "MiB at most"))
    return cards + _evaluated(run.folder)


def _evaluated(folder: Path) -> list[tuple[str, str, str]]:
    """The mesh errors that `idf-slam eval` found, if its results are not older than the mesh."""
    path = folder / result_folder.EVALUATION
    if (
        not path.is_file()
        or not (folder / result_folder.MESH).is_file()
        or path.stat().st_mtime < (folder / result_folder.MESH).stat().st_mtime
    ):
        return []
    values = read_json(path, error=ResultError, expected="what `idf-slam eval` wrote: evaluate the run again")
    try:
        mesh = values.get("mesh")
        if not mesh:
            return []
        ratio = f"cm, {mesh['completion_ratio'] * 100:.0f} % within 5 cm"
        accuracy = ("accuracy", f"{mesh['accuracy'] * 100:.2f}", f"cm, protocol {mesh['protocol']}")
        return [accuracy, ("completion", f"{mesh['completion'] * 100:.2f}", ratio)]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ResultError(f"{path}: lacks an error of the mesh ({shown(error)}), expected what `idf-slam eval` wrote") from error


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
