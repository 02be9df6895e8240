"""Pictures of what a run made: the trajectory and its error, and what the map shows beside what was recorded."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from idfslam.evaluation.trajectory_error import absolute_trajectory_error

Poses = NDArray[np.float64]  # (N, 4, 4) camera-to-world [m]
Image = NDArray[np.float32]  # (H, W, 3) RGB in [0, 1], or (H, W) depth [m]

_MOST_VIEWS = 4  # rows of a comparison
_MILLIMETRES = 1000.0
_FARTHEST = np.iinfo(np.uint16).max


@dataclass(frozen=True, eq=False)
class View:
    """A frame and what the map shows from its pose."""

    index: int
    colour: Image
    depth: Image
    rendered_colour: Image
    rendered_depth: Image


def draw_trajectory(path: Path, poses: Poses, truth: Poses | None) -> None:
    """The path from above (the first camera's x and z) and, where `truth` (at least N poses, NaN: unknown) has any, beside it the error."""
    truth = None if truth is None else truth[: len(poses)]
    known = truth is not None and bool(np.isfinite(truth).all((1, 2)).any())
    figure = Figure(figsize=(11 if known else 5.5, 5), layout="constrained")
    axes = figure.subplots(1, 2 if known else 1, squeeze=False)[0]
    axes[0].plot(poses[:, 0, 3], poses[:, 2, 3], label="estimate", linewidth=1.5)
    if truth is not None and known:
        ate = absolute_trajectory_error(poses, truth)
        T_est_gt = np.linalg.inv(ate.T_gt_est)
        aligned = truth[:, :3, 3] @ T_est_gt[:3, :3].T + T_est_gt[:3, 3]
        axes[0].plot(aligned[:, 0], aligned[:, 2], "k--", label="ground truth", linewidth=1)
        axes[1].plot(ate.frames, ate.errors * 100, linewidth=1)
        axes[1].set(title=f"ATE RMSE {ate.translation.rmse * 100:.2f} cm", xlabel="frame", ylabel="error [cm]")
        axes[1].set_ylim(bottom=0)
        axes[1].grid(alpha=0.3)
    axes[0].set(title="trajectory from above", xlabel="x [m]", ylabel="z [m]", aspect="equal")
    axes[0].set_adjustable("datalim")
    axes[0].grid(alpha=0.3)
    axes[0].legend()
    figure.savefig(path, dpi=100)


def draw_views(path: Path, views: Sequence[View]) -> None:
    """Recorded and rendered colour and depth side by side, a view a row; of many views a few, spread evenly."""
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, min(_MOST_VIEWS, len(views)), dtype=int))]
    figure = Figure(figsize=(14, 2.7 * len(chosen)), layout="constrained")
    for row, view in zip(figure.subplots(len(chosen), 4, squeeze=False), chosen):
        farthest = float(view.depth.max()) or None
        for axes, picture, title in (
            (row[0], view.colour, f"frame {view.index}"),
            (row[1], view.rendered_colour, "rendered"),
            (row[2], view.depth, "depth"),
            (row[3], view.rendered_depth, "rendered"),
        ):
            axes.imshow(np.clip(picture, 0, 1) if picture.ndim == 3 else picture, vmin=0, vmax=farthest, cmap="viridis")
            axes.set_title(title, fontsize=9)
            axes.set_axis_off()
    figure.savefig(path, dpi=80)


def write_colour(path: Path, colour: Image) -> None:
    """(H, W, 3) RGB in [0, 1] -> 8-bit PNG."""
    cv2.imwrite(str(path), (np.clip(colour[..., ::-1], 0, 1) * 255).round().astype(np.uint8))


def write_depth(path: Path, depth: Image) -> None:
    """(H, W) [m] -> 16-bit PNG [mm], 0 = no surface."""
    millimetres = np.nan_to_num(depth * _MILLIMETRES, nan=0, posinf=0)
    cv2.imwrite(str(path), np.clip(millimetres, 0, _FARTHEST).round().astype(np.uint16))
