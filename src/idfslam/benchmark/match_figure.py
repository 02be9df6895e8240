"""Draws matches as in the paper's Fig. 5: two frames side by side, and a line for each inlier match."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

_LINES = 100  # drawn at most, evenly chosen; more: they hide the images


@dataclass(frozen=True, eq=False)
class MatchPicture:
    """The inliers of one method on one pair."""

    title: str
    keyframe: NDArray[np.float32]  # (H, W, 3) RGB in [0, 1]
    frame: NDArray[np.float32]
    pixels: NDArray[np.float64]  # (M, 4): u, v in the frame, u, v in the keyframe


def draw_matches(path: Path, pictures: Sequence[MatchPicture]) -> None:
    """One row for each method: keyframe left, frame right, lines coloured by row in the keyframe. Without pictures no file is written."""
    if not pictures:
        return
    height, width = pictures[0].keyframe.shape[:2]
    figure = Figure(figsize=(10, 0.3 + len(pictures) * (0.3 + 10 * height / (2 * width))), layout="constrained")
    for axes, picture in zip(figure.subplots(len(pictures), 1, squeeze=False)[:, 0], pictures):
        chosen = picture.pixels[np.unique(np.linspace(0, len(picture.pixels) - 1, _LINES).astype(int))]
        chosen = chosen[np.argsort(chosen[:, 3])]
        axes.imshow(np.clip(np.concatenate([picture.keyframe, picture.frame], 1), 0, 1))
        lines = np.stack([chosen[:, 2:], chosen[:, :2] + [width, 0]], 1)
        axes.add_collection(LineCollection(list(lines), array=chosen[:, 3], cmap="rainbow", linewidths=0.6))
        axes.set_title(picture.title, fontsize=9)
        axes.set_axis_off()
    figure.savefig(path, dpi=100)
