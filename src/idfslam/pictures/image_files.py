"""Writes rendered colour and depth as image files, and comparisons with the recorded images."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

Image = NDArray[np.float32]  # (H, W, 3) RGB in [0, 1], or (H, W) depth [m]

_MILLIMETRES = 1000.0
_FARTHEST = np.iinfo(np.uint16).max


@dataclass(frozen=True, eq=False)
class RenderedView:
    """A frame's images and the map rendered from its pose."""

    index: int
    colour: Image
    depth: Image
    rendered_colour: Image
    rendered_depth: Image


def draw_views(path: Path, views: Sequence[RenderedView]) -> None:
    """Recorded and rendered colour and depth side by side, one row for each view."""
    figure = Figure(figsize=(14, 2.7 * len(views)), layout="constrained")
    for row, view in zip(figure.subplots(len(views), 4, squeeze=False), views):
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
    _write(path, to_bytes(colour[..., ::-1]))


def to_bytes(colour: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Colour (H, W, 3) in [0, 1] as bytes; values outside are clipped."""
    return (np.clip(colour, 0, 1) * 255).round().astype(np.uint8)


def write_depth(path: Path, depth: Image) -> None:
    """(H, W) [m] -> 16-bit PNG [mm], 0 = no surface."""
    millimetres = np.nan_to_num(depth * _MILLIMETRES, nan=0, posinf=0)
    _write(path, np.clip(millimetres, 0, _FARTHEST).round().astype(np.uint16))


def _write(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Not cv2.imwrite, which crashes for names that are no UTF-8, and says nothing of a full disk."""
    path.write_bytes(cv2.imencode(path.suffix, image)[1].tobytes())
