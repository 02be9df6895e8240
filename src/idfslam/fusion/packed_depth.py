"""Depth images as they are kept for fusion at the end of a run: reduced by means of neighbouring readings, in 16 bits."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idfslam.fusion.constants import EDGE_SHARE
from idfslam.geometry.camera import Camera
from idfslam.geometry.depth_view import DepthView

Floats = NDArray[np.float32]

ROWS = 240  # [px] least rows of an image that is kept. More: finer edges, more time and memory (154 kB at 240 x 320). Chosen by hand
_LARGEST = np.iinfo(np.uint16).max


@dataclass(frozen=True, eq=False)
class PackedDepth:
    """A depth image of 16 bits."""

    counts: NDArray[np.uint16]  # (h, w) [unit], 0: no reading
    unit: float  # [m]
    camera: Camera

    def view(self, T_wc: NDArray[np.float64]) -> DepthView:
        """The image at a pose (4, 4)."""
        return DepthView(T_wc, self.counts * np.float32(self.unit), self.camera)


def pack_depth(depth: Floats, camera: Camera) -> PackedDepth:
    """Packs depth (H, W) [m], 0: no reading, in at least 240 rows if it has as many. It is off by 1/131 070 of the farthest reading."""
    small, reduced = averaged(depth, camera, max(1, camera.height // ROWS))
    unit = max(float(small.max(initial=0)), 1e-3) / _LARGEST
    return PackedDepth((small / np.float32(unit) + np.float32(0.5)).clip(0, _LARGEST).astype(np.uint16), unit, reduced)


def averaged(depth: Floats, camera: Camera, step: int) -> tuple[Floats, Camera]:
    """Depth (H // step, W // step) [m] and its camera: the mean of step x step readings where they lie on one surface, else one of them.

    One surface is what differs by less than `EDGE_SHARE`: a mean over an edge would be a reading in mid-air.
    """
    height, width = camera.height // step, camera.width // step
    parts = [depth[i::step, j::step][:height, :width] for i in range(step) for j in range(step)]
    one, low, high, total = parts[(step // 2) * (step + 1)], parts[0].copy(), parts[0].copy(), parts[0].copy()
    for part in parts[1:]:
        np.minimum(low, part, out=low)
        np.maximum(high, part, out=high)
        total += part
    same = (low > 0) & (high - low < np.float32(EDGE_SHARE) * one)
    c, middle = camera, (step - 1) / 2
    reduced = Camera(width, height, c.fx / step, c.fy / step, (c.cx - middle) / step, (c.cy - middle) / step)
    return np.where(same, total / np.float32(step * step), np.maximum(one, 0)), reduced
