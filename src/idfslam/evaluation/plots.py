"""Plots of a trajectory and its error over time, as PNG files."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from idfslam.evaluation.consistency import reliability
from idfslam.evaluation.trajectory_error import AbsoluteTrajectoryError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
_ESTIMATE, _TRUTH, _KEYFRAME = "#d1495b", "#30343f", "#edae49"  # colours


def plot_trajectory(
    path: Path,
    estimate: Floats,
    truth: Floats | None = None,
    *,
    T_gt_est: Floats | None = None,
    keyframes: NDArray[np.int64] | None = None,
    before: Floats | None = None,
) -> None:
    """Draws the camera's path from above and from the side into a PNG file.

    The top view shows the two axes of the world along which the path extends most, the side view the first and the third; both have equal
    scales.

    estimate: poses (N, 4, 4). truth: poses (N, 4, 4), NaN where a frame has none. T_gt_est: moves the estimate into the truth's frame.
    keyframes: indices (K,) of the frames to mark. before: poses (N, 4, 4) of the estimate before its loops were closed.
    """
    T = np.eye(4) if T_gt_est is None else T_gt_est
    moved = estimate[:, :3, 3] @ T[:3, :3].T + T[:3, 3]
    reference = moved if truth is None else truth[:, :3, 3]
    axes = np.argsort(-np.ptp(reference[np.isfinite(reference).all(-1)], axis=0), kind="stable")
    figure = _figure(11, 5)
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
        _style(plot)
    handles, labels = plot.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    figure.savefig(path)


def plot_error(path: Path, ate: AbsoluteTrajectoryError, timestamps: Floats) -> None:
    """Draws the position error over time into a PNG file. Frames without truth leave a gap.

    timestamps: (N,) [s] of all frames.
    """
    errors = np.full(len(timestamps), np.nan)
    errors[ate.frames] = ate.errors * 100
    figure = _figure(11, 3.2)
    plot = figure.subplots()
    seconds = timestamps - timestamps[0]
    plot.fill_between(seconds, 0, errors, color=_ESTIMATE, alpha=0.18, linewidth=0)
    plot.plot(seconds, errors, color=_ESTIMATE, linewidth=1.2)
    plot.axhline(ate.translation.rmse * 100, color=_TRUTH, linewidth=1, linestyle="--", label=f"RMSE {ate.translation.rmse * 100:.2f} cm")
    plot.set(xlabel="time [s]", ylabel="position error [cm]", ylim=(0, None))
    plot.margins(x=0)
    plot.legend(frameon=False, loc="upper left")
    _style(plot)
    figure.savefig(path)


def plot_reliability(path: Path, sigmas: Floats, sizes: Floats) -> None:
    """Draws true errors against those that the covariances tell into a PNG file, each frame as a dot and bins of equal numbers as a line.

    sigmas: (M, 2) told errors of shift [m] and turn [rad]. sizes: (M, 2) true ones. Right covariances lie on the diagonal on average.
    """
    figure = _figure(11, 5)
    for column, (plot, name, unit) in enumerate(zip(figure.subplots(1, 2), ("shift [cm]", "turn [degrees]"), (100.0, 180 / np.pi))):
        told, true = sigmas[:, column] * unit, sizes[:, column] * unit
        bins = reliability(told, true)
        ends = [min(told.min(), bins[0].actual), max(told.max(), max(b.actual for b in bins))]
        plot.scatter(told, true, s=4, color=_ESTIMATE, alpha=0.15, linewidth=0, label="a frame", rasterized=True)
        line = [b.predicted for b in bins], [b.actual for b in bins]
        plot.plot(*line, color=_ESTIMATE, marker="o", label=f"RMS of {bins[0].frames} frames")
        plot.plot(ends, ends, color=_TRUTH, linewidth=1, linestyle="--", label="told right")
        plot.set(xscale="log", yscale="log", xlabel=f"told {name}", ylabel=f"true {name}", ylim=(ends[0] / 10, None))
        plot.legend(frameon=False, loc="upper left")
        _style(plot)
    figure.savefig(path)


def _figure(width: float, height: float) -> "Figure":
    """An empty figure [inches] that needs no window; matplotlib is imported here, since many runs draw nothing."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _style(plot: "Axes") -> None:
    plot.grid(alpha=0.25, linewidth=0.6)
    plot.spines[["top", "right"]].set_visible(False)
