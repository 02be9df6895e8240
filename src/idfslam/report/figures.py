"""The charts of a report."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from idfslam.frame import Status
from idfslam.report.chart import DEGENERATE, DOUBTFUL, ESTIMATE, INK, KEYFRAME, LOST, SERIES, WIDTH, Chart, chart, key
from idfslam.runs.frame_log import FrameLog

Floats = NDArray[np.float64]
_MAX_SERIES = 6  # losses in one chart; more: hard to tell apart
_SLICE_WIDTH = 4.2  # [inch]: three slices fit next to each other


@dataclass(frozen=True, eq=False)
class CameraPath:
    """The camera's path in level coordinates (z up)."""

    estimate: Floats  # (N, 3) [m]
    truth: Floats | None  # (N, 3) [m], NaN where it is unknown
    keyframes: NDArray[np.int64]  # (K,)


@dataclass(frozen=True, eq=False)
class Plan:
    """A picture of the room from above or a slice of the map, and its extent."""

    image: NDArray[np.generic]  # (H, W, 4) uint8 or (H, W) float, first row at the largest y
    extent: tuple[float, float, float, float]  # left, right, bottom, top [m]


def trajectory_chart(path: CameraPath, axes: tuple[int, int], plan: Plan | None = None) -> Chart:
    """The path along two axes of level coordinates, over the room's plan."""
    a, b = axes

    def draw(figure: Figure) -> None:
        plot = figure.subplots()
        if plan is not None:
            plot.imshow(plan.image, extent=plan.extent, alpha=0.75, interpolation="antialiased")
            plot.grid(False)
        if path.truth is not None:
            plot.plot(path.truth[:, a], path.truth[:, b], color=INK, linewidth=2.4, alpha=0.8, label="ground truth")
        plot.plot(path.estimate[:, a], path.estimate[:, b], color=ESTIMATE, linewidth=1.5, label="estimate")
        at = path.estimate[path.keyframes]
        plot.scatter(at[:, a], at[:, b], s=12, color=KEYFRAME, zorder=3, label=f"{len(at)} keyframes")
        for point, marker in ((path.estimate[0], "o"), (path.estimate[-1], "s")):
            plot.scatter(point[a], point[b], s=46, marker=marker, color="white", edgecolor=ESTIMATE, linewidth=1.6, zorder=4)
        plot.set(xlabel=f"{'xyz'[a]} [m]", ylabel=f"{'xyz'[b]} [m]")
        plot.set_aspect("equal", adjustable="datalim" if plan is None else "box")
        if plan is not None:
            plot.set(xlim=plan.extent[:2], ylim=plan.extent[2:])
        key(plot, 3)

    return chart(f"trajectory{a}{b}", _height(plan, path.estimate[:, [a, b]]), draw)


def _height(plan: Plan | None, points: Floats, width: float = WIDTH) -> float:
    """The height [inch] of a chart of the given width, by the shape of the plan or the points."""
    if plan is None:
        wide, high = np.ptp(points, axis=0)
    else:
        wide, high = plan.extent[1] - plan.extent[0], plan.extent[3] - plan.extent[2]
    return float(np.clip(0.88 * width * high / max(wide, 1e-6), 1.4, 6.0)) + 0.8


def error_chart(seconds: Floats, errors: Floats, rmse: float) -> Chart:
    """Distance to the truth [m] (N,), NaN where it is unknown, over time."""

    def draw(figure: Figure) -> None:
        plot = figure.subplots()
        plot.fill_between(seconds, 0, errors * 100, color=ESTIMATE, alpha=0.18, linewidth=0)
        plot.plot(seconds, errors * 100, color=ESTIMATE, linewidth=1.2, label="position error")
        plot.axhline(rmse * 100, color=INK, linewidth=1, linestyle="--", label=f"RMSE {rmse * 100:.2f} cm")
        plot.set(xlabel="time [s]", ylabel="error [cm]", ylim=(0, None))
        plot.margins(x=0)
        key(plot)

    return chart("error", 2.5, draw)


def frames_chart(log: FrameLog) -> Chart:
    """Milliseconds of each frame, and below it keyframes and frames whose pose is not sure."""
    index = np.array([line.index for line in log.lines])
    ms = np.array([line.ms for line in log.lines])
    smooth = np.array([np.median(ms[max(0, i - 10) : i + 11]) for i in range(len(ms))])
    kinds = ((Status.LOST, LOST), (Status.INTERPOLATED, LOST), (Status.DOUBTFUL, DOUBTFUL), (Status.DEGENERATE, DEGENERATE))

    def draw(figure: Figure) -> None:
        plot, strip = figure.subplots(2, 1, sharex=True, height_ratios=(6, 1.4))
        plot.scatter(index, ms, s=5, color=SERIES[0], alpha=0.5, linewidth=0, label="a frame", rasterized=len(ms) > 3000)
        plot.plot(index, smooth, color=ESTIMATE, linewidth=1.4, label="median of 21")
        plot.set(ylabel="time [ms]", ylim=(0, 1.4 * float(np.percentile(ms, 97)) if len(ms) > 20 else None))
        key(plot)
        for row, found, colour in ((1, [line.index for line in log.lines if line.keyframe], KEYFRAME), *_rows(log, kinds)):
            strip.vlines(found, row + 0.08, row + 0.92, color=colour, linewidth=1.6)
        strip.set(yticks=[0.5, 1.5], yticklabels=["doubt", "keyframe"], ylim=(0, 2), xlabel="frame")
        strip.grid(False)
        strip.spines["left"].set_visible(False)
        strip.tick_params(axis="y", length=0)
        counts = [f"{name.value} {sum(line.status is name for line in log.lines)}" for name in Status]
        strip.set_title("frames: " + ", ".join(counts), loc="left", pad=2)

    return chart("frames", 3.2, draw)


def _rows(log: FrameLog, kinds: tuple[tuple[Status, str], ...]) -> list[tuple[int, list[int], str]]:
    return [(0, [line.index for line in log.lines if line.status is status], colour) for status, colour in kinds]


def stages_chart(ms: Mapping[str, float]) -> Chart:
    """Mean milliseconds a frame by stage."""
    stages = sorted(ms.items(), key=lambda item: item[1])

    def draw(figure: Figure) -> None:
        plot = figure.subplots()
        bars = plot.barh([name for name, _ in stages], [value for _, value in stages], color=SERIES[0], height=0.66)
        plot.bar_label(bars, [f"{value:.1f}" for _, value in stages], padding=4)
        plot.set(xlabel="ms a frame, mean")
        plot.margins(x=0.12)
        plot.grid(axis="y", visible=False)

    return chart("stages", 0.9 + 0.28 * len(stages), draw)


def losses_chart(log: FrameLog) -> Chart | None:
    """Losses over the frames on a logarithmic scale, the total first; None if none was recorded."""
    found = {name: values for name, values in log.losses.items() if (np.nan_to_num(values) > 0).sum() > 1}
    names = sorted(found, key=lambda name: (name != "total", name.startswith("finetune"), name))[:_MAX_SERIES]
    if not names:
        return None

    def draw(figure: Figure) -> None:
        plot = figure.subplots()
        for name, colour in zip(names, SERIES):
            at = np.flatnonzero(np.nan_to_num(found[name]) > 0)
            plot.plot(at, found[name][at], color=colour, linewidth=1.8 if name == "total" else 1.1, label=name.replace("_", " "))
        plot.set(yscale="log", xlabel="frame", ylabel="loss")
        plot.margins(x=0)
        key(plot, 3)

    return chart("losses", 2.9, draw)


def slice_chart(name: str, plan: Plan, path: CameraPath, reach: float) -> Chart:
    """The signed distance on a horizontal plane [m], NaN where nothing was observed. reach: end of the colour scale [m]."""

    def draw(figure: Figure) -> None:
        plot = figure.subplots()
        centimetres = np.asarray(plan.image, np.float64) * 100
        shown = plot.imshow(centimetres, extent=plan.extent, cmap="RdBu", vmin=-reach * 100, vmax=reach * 100)
        _surface(plot, centimetres, plan.extent)
        plot.plot(path.estimate[:, 0], path.estimate[:, 1], color=KEYFRAME, linewidth=1.1)
        plot.set(xlabel="x [m]", ylabel="y [m]")
        plot.grid(False)
        bar = figure.colorbar(shown, ax=plot, location="bottom", shrink=0.7, aspect=28, label="signed distance [cm]")
        bar.outline.set_visible(False)  # type: ignore[operator]

    return chart(name, _height(plan, path.estimate[:, :2], _SLICE_WIDTH) + 0.5, draw, width=_SLICE_WIDTH)


def _surface(plot: Axes, distance: Floats, extent: tuple[float, float, float, float]) -> None:
    """Draws the zero level of the distance: the surface."""
    if np.nanmin(distance, initial=1) < 0 < np.nanmax(distance, initial=-1):
        plot.contour(distance, levels=[0], extent=extent, origin="upper", colors=INK, linewidths=0.9)
