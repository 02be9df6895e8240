"""What an evaluation found, for people and programs: a table, JSON, and plots of the trajectory."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.markup import escape
from rich.table import Table

from idfslam.evaluation.mesh_error import MeshError
from idfslam.evaluation.trajectory_error import AbsoluteTrajectoryError, RelativePoseError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]
_ESTIMATE, _TRUTH, _KEYFRAME = "#d1495b", "#30343f", "#edae49"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All that was measured of one run; no RPE of a delta that no two frames are apart, no mesh error without a true mesh."""

    frames: int
    ate: AbsoluteTrajectoryError
    rpe: tuple[RelativePoseError, ...]
    mesh: MeshError | None

    def to_dict(self) -> dict[str, Any]:
        """Metres and degrees, named so; what JSON can hold."""
        found: dict[str, Any] = {"frames": self.frames, "frames_with_truth": len(self.ate.frames)}
        found |= {"ate_m": asdict(self.ate.translation), "T_gt_est": self.ate.T_gt_est.tolist()}
        for rpe in self.rpe:
            pairs = {"pairs": len(rpe.frames)}
            found[f"rpe_{rpe.delta}"] = {**pairs, "translation_m": asdict(rpe.translation), "rotation_deg": asdict(rpe.rotation)}
        if self.mesh is not None:
            found["mesh"] = asdict(self.mesh)
        return found


def table(evaluation: Evaluation) -> Table:
    """For the console: centimetres, degrees and per cent."""
    result = Table(title=f"{evaluation.frames} frames", title_justify="left")
    for column in ("error", "RMSE", "mean", "median", "max", "std"):
        result.add_column(column, justify="left" if column == "error" else "right")
    rows = [(f"ATE [cm], {len(evaluation.ate.frames)} frames", evaluation.ate.translation, 100.0)]
    for rpe in evaluation.rpe:
        frames = "1 frame" if rpe.delta == 1 else f"{rpe.delta} frames"
        rows += [(f"RPE over {frames} [cm]", rpe.translation, 100.0), (f"RPE over {frames} [deg]", rpe.rotation, 1.0)]
    for name, s, unit in rows:
        result.add_row(escape(name), *(f"{value * unit:.3f}" for value in (s.rmse, s.mean, s.median, s.max, s.std)))
    if evaluation.mesh is not None:
        result.add_section()
        for name, text in _mesh_rows(evaluation.mesh):
            result.add_row(escape(f"{name}, protocol {evaluation.mesh.protocol}"), "", text)
    return result


def _mesh_rows(mesh: MeshError) -> list[tuple[str, str]]:
    rows = [
        ("accuracy [cm]", f"{mesh.accuracy * 100:.2f}"),
        ("completion [cm]", f"{mesh.completion * 100:.2f}"),
        ("completion ratio < 5 cm [%]", f"{mesh.completion_ratio * 100:.1f}"),
    ]
    if mesh.depth_l1 is not None and mesh.depth_missing is not None:
        rows += [("depth L1 [cm]", f"{mesh.depth_l1 * 100:.2f}"), ("depth missing [%]", f"{mesh.depth_missing * 100:.1f}")]
    rows.append(("depth read [m]" if mesh.range_from == "recording" else "depth [m]", f"{mesh.near:.2f} to {mesh.far:.2f}"))
    return rows


def save_json(path: Path, evaluation: Evaluation) -> None:
    """Writes `Evaluation.to_dict`; what is not a number becomes null."""
    path.write_text(json.dumps(_finite(evaluation.to_dict()), indent=2) + "\n", encoding="utf-8")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def plot_trajectory(
    path: Path,
    estimate: Floats,
    truth: Floats | None = None,
    *,
    T_gt_est: Floats | None = None,
    keyframes: NDArray[np.int64] | None = None,
    before: Floats | None = None,
) -> None:
    """PNG of the path from above and from the side: along the two largest extents, and along the first and the third, equal axes.

    Poses (N, 4, 4); the truth has NaN where a frame has none; `T_gt_est` moves the estimate beside it; `keyframes` (K,) are marked.
    before (N, 4, 4): the estimate before its loops were closed.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    T = np.eye(4) if T_gt_est is None else T_gt_est
    moved = estimate[:, :3, 3] @ T[:3, :3].T + T[:3, 3]
    reference = moved if truth is None else truth[:, :3, 3]
    axes = np.argsort(-np.ptp(reference[np.isfinite(reference).all(-1)], axis=0), kind="stable")
    figure = Figure(figsize=(11, 5), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    for plot, (a, b), title in zip(figure.subplots(1, 2), (axes[:2], axes[[0, 2]]), ("top view", "side view")):
        if truth is not None:
            plot.plot(reference[:, a], reference[:, b], color=_TRUTH, linewidth=2.2, alpha=0.75, label="ground truth")
        if before is not None:
            tracked = before[:, :3, 3] @ T[:3, :3].T + T[:3, 3]
            plot.plot(tracked[:, a], tracked[:, b], color=_ESTIMATE, linewidth=0.9, linestyle=":", label="before closing loops")
        plot.plot(moved[:, a], moved[:, b], color=_ESTIMATE, linewidth=1.3, label="estimate")
        if keyframes is not None and len(keyframes):
            plot.scatter(moved[keyframes, a], moved[keyframes, b], s=14, color=_KEYFRAME, zorder=3, label=f"{len(keyframes)} keyframes")
        plot.scatter(*moved[0, [a, b]], s=60, marker="o", color="white", edgecolor=_ESTIMATE, zorder=4, label="start")
        plot.scatter(*moved[-1, [a, b]], s=60, marker="s", color=_ESTIMATE, edgecolor="white", zorder=4, label="end")
        plot.set(title=title, xlabel=f"{'xyz'[a]} [m]", ylabel=f"{'xyz'[b]} [m]")
        plot.set_aspect("equal", adjustable="datalim")
        _tidy(plot)
    handles, labels = plot.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(path)


def plot_error(path: Path, ate: AbsoluteTrajectoryError, timestamps: Floats) -> None:
    """PNG of the distance between estimate and truth over time; `timestamps` (N,) [s] of all frames. Frames without truth leave a gap."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    errors = np.full(len(timestamps), np.nan)
    errors[ate.frames] = ate.errors * 100
    figure = Figure(figsize=(11, 3.2), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    plot = figure.subplots()
    seconds = timestamps - timestamps[0]
    plot.fill_between(seconds, 0, errors, color=_ESTIMATE, alpha=0.18, linewidth=0)
    plot.plot(seconds, errors, color=_ESTIMATE, linewidth=1.2)
    plot.axhline(ate.translation.rmse * 100, color=_TRUTH, linewidth=1, linestyle="--", label=f"RMSE {ate.translation.rmse * 100:.2f} cm")
    plot.set(xlabel="time [s]", ylabel="position error [cm]", ylim=(0, None))
    plot.margins(x=0)
    plot.legend(frameon=False, loc="upper left")
    _tidy(plot)
    figure.savefig(path)


def _tidy(plot: "Axes") -> None:
    plot.grid(alpha=0.25, linewidth=0.6)
    plot.spines[["top", "right"]].set_visible(False)
