"""The overlap of two depth images at a relative pose: which pixels see the same points, and how well the depths agree."""

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from idfslam.geometry import se3
from idfslam.geometry.camera import Camera


class DepthImage(Protocol):
    """An image of points."""

    @property
    def points(self) -> Tensor: ...  # (h, w, 3) in the camera's frame [m]

    @property
    def valid(self) -> Tensor: ...  # (h, w) bool: pixels with depth

    @property
    def camera(self) -> Camera: ...


@dataclass(frozen=True)
class Overlap:
    """Pixels of view b that view a sees too."""

    index: Tensor  # (N,) int64: flat indices of the pixels in b
    uv: Tensor  # (N, 2) where a sees them [px]
    depth_consistency: float  # of b's points that a should see (measured there and not occluded), the share that lies on a's surface


@torch.no_grad()
def overlapping_pixels(T_ab: Tensor, a: DepthImage, b: DepthImage, tolerance: float = 0.03) -> Overlap:
    """Pixels of b that a sees too, by T_ab (4, 4) and depth. Depths agree within `tolerance` [1] of them; less than 1 m counts as 1 m."""
    index = b.valid.flatten().nonzero()[:, 0]
    uv, z = a.camera.project(se3.transform(T_ab.to(b.points), b.points.flatten(0, 1)[index]))
    inside = a.camera.inside(uv, z)
    index, uv, z = index[inside], uv[inside], z[inside]
    nearest = uv.round().long()
    behind = z - a.points[nearest[:, 1], nearest[:, 0], 2]
    measured, slack = a.valid[nearest[:, 1], nearest[:, 0]], tolerance * z.clamp(min=1)
    agrees = measured & (behind.abs() < slack)
    visible = measured & (behind < slack)
    return Overlap(index[agrees], uv[agrees], float(agrees.sum() / visible.sum().clamp(min=1)))
