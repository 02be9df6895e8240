"""Depth of an unknown moment: the displacement of the camera since colour was taken is one more unknown, and is marginalised out.

Depth that is taken d seconds after its time stamp sees the camera displaced by d times its velocity against the references. Then depth and
images contradict each other, and their common solution can be off by several times as much as either: both leave about the same directions
half open, and two narrow valleys side by side meet far away. So until the delay is known the displacement is unknown too. It has a Gaussian
prior, and is marginalised out of the equations of depth (Schur complement).
"""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from idfslam.alignment.depth_term import DepthTerm
from idfslam.alignment.motion import moved
from idfslam.alignment.row_moments import Array, RowMoments


class DepthAtPose:
    """The depth of a frame that was taken where its colour was."""

    def pose(self, T_wc: Tensor) -> Tensor:
        """(4, 4) where the camera was when it took the depth of a frame at this pose (4, 4)."""
        return T_wc

    def marginalised(self, depth: DepthTerm) -> DepthTerm:
        """The equations of depth at `pose(T_wc)`, as equations of the frame's pose alone. Both are of one moment: they stay as they are."""
        return depth


class DisplacedDepth(DepthAtPose):
    """The depth of one frame while it is aligned, with the displacement (6,) of the camera that fits it so far."""

    def __init__(self, covariance: Array, scale: float) -> None:
        """covariance (6, 6): of the displacement, a shift [m] and a turn [rad]. scale: of the sums of depth, in units of information."""
        self.displacement, self._information = np.zeros(6), np.linalg.inv(scale * covariance)

    def pose(self, T_wc: Tensor) -> Tensor:
        return moved(T_wc, torch.from_numpy(self.displacement))

    def marginalised(self, depth: DepthTerm) -> DepthTerm:
        """The equations of depth with the displacement marginalised out, which moves to its estimate at this step."""
        H, b = depth.sums.H[0], depth.sums.b[0]
        both = np.column_stack([H, b - self._information @ self.displacement])
        gain = np.linalg.solve(H + self._information, both)
        self.displacement = self.displacement + gain[:, 6]
        return replace(depth, sums=RowMoments((H - H @ gain[:, :6])[None], (b - H @ gain[:, 6])[None]))
