"""Submaps: parts of the graph whose relative pose is not known yet (the atlas of ORB-SLAM3, Campos et al., T-RO 2021).

Where a lost camera is not found again, mapping goes on in a new submap, until one of its views is found in another submap. All submaps
lie in one world, so far from each other that one map holds them all. Only the first, whose world it is, is reported.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe

_SEPARATION = 100.0  # [m] from all earlier keyframes. More: longer walks in a submap stay clear of the others; single precision
#                      still resolves 0.01 mm at 100 m.


def separate_origin(keyframes: Sequence[Keyframe]) -> Tensor:
    """A pose (4, 4) at which a new submap can begin."""
    T_wk = torch.eye(4, dtype=torch.float64)
    T_wk[0, 3] = max(float(keyframe.T_wk[0, 3]) for keyframe in keyframes) + _SEPARATION
    return T_wk


def merged_poses(keyframes: Sequence[Keyframe], a: int, b: int, T_ab: Tensor) -> list[Tensor]:
    """All poses T_wk after the submaps of keyframes a and b were placed by T_ab (4, 4): the younger submap moves."""
    first, second = keyframes[a], keyframes[b]
    change = first.T_wk @ T_ab @ se3.inverse(second.T_wk)  # of the submap of b
    moving = max(first.submap, second.submap)
    if moving == first.submap:
        change = se3.inverse(change)
    return [se3.orthonormal(change @ k.T_wk) if k.submap == moving else k.T_wk for k in keyframes]
