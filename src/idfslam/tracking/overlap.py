"""Which pixels of two depth images see the same point at a given pose, and how well the images agree there."""

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from idfslam.geometry import se3
from idfslam.geometry.camera import Camera


class DepthImage(Protocol):
    """Points of an image."""

    @property
    def points(self) -> Tensor: ...  # (h, w, 3) in the camera's frame [m]

    @property
    def valid(self) -> Tensor: ...  # (h, w) bool: pixels with depth

    @property
    def camera(self) -> Camera: ...


@dataclass(frozen=True)
class Partners:
    """Pixels of one view that another sees too."""

    index: Tensor  # (N,) int64, flat
    uv: Tensor  # (N, 2) their places in the other view [px]
    agreement: float  # the share of the points on measured pixels of the other view, not hidden behind them, that lie on its surface


@torch.no_grad()
def partners(T_ab: Tensor, a: DepthImage, b: DepthImage, tolerance: float = 0.03) -> Partners:
    """Pixels of b that a sees too, by pose and depth, which agree within `tolerance` times the depth, taken as 1 m at least."""
    index = b.valid.flatten().nonzero()[:, 0]
    uv, z = a.camera.project(se3.transform(T_ab.to(b.points), b.points.flatten(0, 1)[index]))
    inside = a.camera.inside(uv, z)
    index, uv, z = index[inside], uv[inside], z[inside]
    nearest = uv.round().long()
    behind = z - a.points[nearest[:, 1], nearest[:, 0], 2]
    measured, slack = a.valid[nearest[:, 1], nearest[:, 0]], tolerance * z.clamp(min=1)
    agrees = measured & (behind.abs() < slack)
    visible = measured & (behind < slack)
    return Partners(index[agrees], uv[agrees], float(agrees.sum() / visible.sum().clamp(min=1)))
