"""Resection: the pose of an image from points that it shows and whose places are known (spatial resection).

The pose before, with its covariance, counts as a measurement too: where few points are in view, it holds what they do not.
"""

import torch
from torch import Tensor

from idfslam.alignment.motion import change_between
from idfslam.geometry import se3
from idfslam.tracking.patch_alignment import AlignedPatches

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
