"""Resection: the pose of an image from points that it shows and whose places are known (spatial resection).

The pose before, with its covariance, counts as a measurement too: where few points are in view, it holds what they do not.
"""

from dataclasses import replace

import torch
from torch import Tensor

from idfslam.alignment.motion import change_between
from idfslam.geometry import se3
from idfslam.tracking.patch_alignment import AlignedPatches

_NEAREST = 0.1  # [m] depth from which the projection of a nearer point's spread is computed. More: near points count more. Chosen by hand
# [standard deviations] Scale of the robust weights in each step. More: outliers count more; more steps: slower. Chosen by hand
_SCALES = 12.0, 6.0, 6.0, 6.0


def resected(T_before: Tensor, covariance: Tensor, seen: AlignedPatches) -> Tensor:
    """The pose T_wc (4, 4) of an image that shows points of the world, from a pose before and its covariance (6, 6).

    The covariance is of shift [m] and turn [rad] along world axes.
    """
    T, information = T_before, torch.linalg.inv(covariance)
    for scale in _SCALES:
        H, b = seen.system(T, scale)
        by_step = torch.eye(6, dtype=torch.float64)  # of exp(step) T: its centre moves by v + omega x t
        by_step[:3, 3:] = -se3.hat(T[:3, 3])
        pull = by_step.T @ information
        T = se3.exp(torch.linalg.solve(H + pull @ by_step, b - pull @ change_between(T_before, T))) @ T
    return se3.orthonormal(T)


def with_spread(seen: AlignedPatches, T_wc: Tensor, spread: Tensor) -> AlignedPatches:
    """What an image at about T_wc (4, 4) shows of points that lie along a line each, by a standard deviation `spread` (N, 3) [m] of it.

    A place along the projection of that line tells the less, the farther the line spreads there (Sherman and Morrison's formula).
    """
    x, y, z = (se3.transform(se3.inverse(T_wc), seen.points)).unbind(-1)
    z = z.clamp(min=_NEAREST)
    dx, dy, dz = (spread @ T_wc[:3, :3]).unbind(-1)
    moved = torch.stack([seen.camera.fx * (dx - x / z * dz) / z, seen.camera.fy * (dy - y / z * dz) / z], -1)
    drawn = (seen.information @ moved[..., None])[..., 0]
    lost = drawn[:, :, None] * drawn[:, None] / (1 + (moved * drawn).sum(-1))[:, None, None]
    return replace(seen, information=seen.information - lost)
