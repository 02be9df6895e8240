"""The cards at the top of a report: the numbers that say most about a run."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.errors import ResultError
from idfslam.evaluation.evaluate import evaluate_poses
from idfslam.report.known_error import KnownError
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.storage.json_file import read_json
from idfslam.storage.plain_values import shown


class Card(NamedTuple):
    """A number of the run."""

    label: str
    value: str
    remark: str  # its unit, and what else is to be said


def cards_of(run: FinishedRun, error: KnownError | None, metrics: dict[str, Any], mesh: trimesh.Trimesh | None) -> list[Card]:
    """The cards of a run. metrics: the values of its metrics.json, as far as there are any."""
    path = np.linalg.norm(np.diff(run.trajectory.positions, axis=0), axis=-1).sum()
    stamps = run.trajectory.timestamps
    cards = [Card("frames", f"{len(stamps)}", f"{stamps[-1] - stamps[0]:.1f} s, {path:.1f} m of path")]
    if "frames_per_second" in metrics:
        cards.append(Card("speed", f"{metrics['frames_per_second']:.1f}", f"frames/s, {metrics['seconds']:.0f} s in all"))
    if error is not None:
        s = error.ate.translation
        cards.append(Card("ATE RMSE", f"{s.rmse * 100:.2f}", f"cm, largest {s.max * 100:.2f} cm"))
        cards += _measured(run, error.truth)
    if "lost_frames" in metrics:
        others = f"and {metrics.get('degenerate_frames', 0)} degenerate, {metrics.get('doubtful_frames', 0)} doubtful"
        cards.append(Card("lost frames", f"{metrics['lost_frames']}", others))
    if metrics.get("submaps", 1) > 1:
        cards.append(Card("submaps apart", f"{metrics['submaps'] - 1}", "never met the largest one, and are left out"))
    cards.append(Card("keyframes", f"{len(run.keyframes.indices)}", f"{run.keyframes.camera.width} x {run.keyframes.camera.height} px"))
    if mesh is not None:
        cards.append(Card("mesh", f"{mesh.area:.0f}", f"m² in {len(mesh.faces) / 1000:.0f} k triangles"))
    if (run.folder / result_folder.MAP).is_file():
        cards.append(Card("map", f"{(run.folder / result_folder.MAP).stat().st_size / 1e6:.1f}", "MB on disk"))
    if metrics.get("peak_memory_mb") is not None:
        cards.append(Card("memory", f"{metrics['peak_memory_mb']:.0f}", "MiB at most"))
    return cards + _evaluated(run.folder)


def _measured(run: FinishedRun, truth: NDArray[np.float64]) -> list[Card]:
    """The card of the error over the frames whose pose was measured; none where these are all frames, or unknown."""
    if run.measured.all():
        return []
    errors = evaluate_poses(run.trajectory.poses, truth, measured=run.measured).measured
    if errors is None:
        return []
    return [Card("ATE, measured", f"{errors.ate.translation.rmse * 100:.2f}", f"cm, {errors.frames} measured poses")]


def _evaluated(folder: Path) -> list[Card]:
    """The mesh errors that `idf-slam eval` found, if its results are not older than the mesh."""
    path, mesh_file = folder / result_folder.EVALUATION, folder / result_folder.MESH
    if not path.is_file() or not mesh_file.is_file() or path.stat().st_mtime < mesh_file.stat().st_mtime:
        return []
    values = read_json(path, error=ResultError, expected="what `idf-slam eval` wrote: evaluate the run again")
    try:
        mesh = values.get("mesh")
        if not mesh:
            return []
        return [
            Card("accuracy", f"{mesh['accuracy'] * 100:.2f}", f"cm, protocol {mesh['protocol']}"),
            Card("completion", f"{mesh['completion'] * 100:.2f}", f"cm, {mesh['completion_ratio'] * 100:.0f} % within 5 cm"),
        ]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ResultError(f"{path}: lacks an error of the mesh ({shown(error)}), expected what `idf-slam eval` wrote") from error
