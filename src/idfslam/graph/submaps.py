"""Pieces: parts of the graph whose places beside each other are not known yet.

Where a lost camera is not found again, mapping goes on in a new piece, until a view of it is found in another one. All pieces lie in one
world, so far from each other that one map holds them all; only the first, whose world it is, is told to the outside. ORB-SLAM3 calls the
like an atlas (Campos et al., T-RO 2021).
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe

_APART = 100.0  # [m] from everything before it: no walk that is not connected with it comes near, and single precision still tells 0.01 mm


def far_from(keyframes: Sequence[Keyframe]) -> Tensor:
    """A pose (4, 4) for a new piece to begin at."""
    T_wk = torch.eye(4, dtype=torch.float64)
    T_wk[0, 3] = max(float(keyframe.T_wk[0, 3]) for keyframe in keyframes) + _APART
    return T_wk


def brought_together(keyframes: Sequence[Keyframe], a: int, b: int, T_ab: Tensor) -> list[Tensor]:
    """All poses T_wk with the pieces of keyframes a and b as T_ab (4, 4) has them: the younger one moves."""
    first, second = keyframes[a], keyframes[b]
    change = first.T_wk @ T_ab @ se3.inverse(second.T_wk)  # of the piece of b
    moving = max(first.piece, second.piece)
    if moving == first.piece:
        change = se3.inverse(change)
    return [se3.orthonormal(change @ k.T_wk) if k.piece == moving else k.T_wk for k in keyframes]
