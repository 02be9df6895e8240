"""Submaps: parts of the graph whose relative pose is not known yet (the atlas of ORB-SLAM3, Campos et al., T-RO 2021).

If a lost camera is not relocalised, mapping goes on in a new submap. Submaps are merged when a view of one is found in another. All submaps
lie in one world, far enough from each other that one map represents them all. Only one is reported, the main one. It is the first while the
camera moves, and the largest at the end: a camera that was lost after a few frames has left a small one behind.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe

# [m] Distance of a new submap from all earlier keyframes. More: longer walks in a submap stay clear of the others, at less precision:
# single precision resolves 0.01 mm at 100 m. Chosen by hand.
_SEPARATION = 100.0


def separate_origin(keyframes: Sequence[Keyframe]) -> Tensor:
    """A pose (4, 4) at which a new submap can start."""
    T_wk = torch.eye(4, dtype=torch.float64)
    T_wk[0, 3] = max(float(keyframe.T_wk[0, 3]) for keyframe in keyframes) + _SEPARATION
    return T_wk


def merged_poses(keyframes: Sequence[Keyframe], a: int, b: int, T_ab: Tensor) -> list[Tensor]:
    """All poses T_wk (4, 4) after the submaps of keyframes a and b are merged by T_ab (4, 4). The younger submap moves."""
    first, second = keyframes[a], keyframes[b]
    change = first.T_wk @ T_ab @ se3.inverse(second.T_wk)  # of the submap of b
    moving = max(first.submap, second.submap)
    if moving == first.submap:
        change = se3.inverse(change)
    return [se3.orthonormal(change @ k.T_wk) if k.submap == moving else k.T_wk for k in keyframes]
