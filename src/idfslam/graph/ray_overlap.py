"""Overlap of a frame with keyframes by samples on its rays, as in NICE-SLAM's code: what lies around its surface may be in their sight."""

from collections.abc import Sequence

import torch
from torch import Tensor

from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe

# All three are those of NICE-SLAM's code.
_PIXELS, _SAMPLES = 100, 16  # rays of the frame, and samples on each. More: a surer share, at proportional time
_BEFORE, _BEHIND = 0.8, 0.5  # [1] of the reading where samples begin, [m] behind it where they end. Wider: more keyframes overlap
_BORDER = 20  # [px] along the borders of a keyframe's image that do not count. More: fewer keyframes overlap


def ray_overlap(view: Keyframe, keyframes: Sequence[Keyframe], generator: torch.Generator) -> list[float]:
    """Share of the samples on a frame's rays that each keyframe has in sight. Rays without a reading have their samples at the camera."""
    size = torch.tensor([view.camera.width, view.camera.height])
    uv = (torch.rand(_PIXELS, 2, generator=generator) * size).long()
    depth = view.depth.cpu()[uv[:, 1], uv[:, 0]].double()
    share = torch.linspace(0, 1, _SAMPLES, dtype=torch.float64)
    along = depth[:, None] * _BEFORE * (1 - share) + (depth[:, None] + _BEHIND) * share
    points = se3.transform(view.T_wk, (view.camera.rays(uv.double())[:, None] * along[..., None]).reshape(-1, 3))
    return [in_sight(keyframe, points) for keyframe in keyframes]


def in_sight(keyframe: Keyframe, points: Tensor) -> float:
    """Share of points (N, 3) [m] of the world that project into a keyframe's image, away from its borders."""
    uv, z = keyframe.camera.project(se3.transform(se3.inverse(keyframe.T_wk), points))
    border = min(_BORDER, min(keyframe.camera.width, keyframe.camera.height) // 4)  # of small images a quarter is left
    inside = (uv > border).all(-1) & (uv[:, 0] < keyframe.camera.width - border) & (uv[:, 1] < keyframe.camera.height - border)
    return float((inside & (z > 0)).double().mean())
