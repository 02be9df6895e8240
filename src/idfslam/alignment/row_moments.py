"""Normal equations of a pose with their moments over the rows of a rolling shutter.

A residual of row f (-0.5 at the top of the image, 0.5 at the bottom) has the time s = delay + readout f. It depends on the pose by J, and
on the velocity by s J. So the normal equations of pose and velocity follow from three sums: of J^T J, f J^T J and f^2 J^T J.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RowMoments:
    """Sums over residuals r with weights w: H[k] = sum w f^k J^T J and b[k] = -sum w f^k J^T r. They are on the host."""

    H: Array  # (3, 6, 6); (1, 6, 6) without moments
    b: Array  # (2, 6); (1, 6) without moments

    @classmethod
    def zeros(cls, *, moments: bool) -> "RowMoments":
        """Empty sums, with room for moments or without."""
        return cls(np.zeros((3 if moments else 1, 6, 6)), np.zeros((2 if moments else 1, 6)))

    @classmethod
    def of(cls, J: Tensor, w: Tensor, r: Tensor, rows: Tensor | None) -> "RowMoments":
        """The sums of Jacobians J (N, 6), weights w (N,), residuals r (N,) in rows (N,); None: without moments."""
        powers = [torch.ones_like(w)] if rows is None else [torch.ones_like(w), rows, rows * rows]
        H = torch.stack([(J * (w * power)[:, None]).T @ J for power in powers])
        b = torch.stack([-(J * (w * power)[:, None]).T @ r for power in powers[:2]])
        return cls(H.double().cpu().numpy(), b.double().cpu().numpy())

    def __add__(self, other: "RowMoments") -> "RowMoments":
        return RowMoments(self.H + other.H, self.b + other.b)

    def carried(self, change: Array) -> "RowMoments":
        """The sums about a pose from which theirs is the change (6,) away, to first order."""
        return RowMoments(self.H, self.b + self.H[: len(self.b)] @ change)

    def scaled(self, factor: float) -> "RowMoments":
        """All sums times a factor."""
        return RowMoments(factor * self.H, factor * self.b)


@dataclass(frozen=True)
class PoseEquations:
    """Normal equations H delta = b of a pose; delta is a shift and a turn about the camera's centre, both along world axes."""

    sums: RowMoments

    @property
    def H(self) -> Tensor:
        """(6, 6) float64, on the host."""
        return torch.from_numpy(self.sums.H[0])

    @property
    def b(self) -> Tensor:
        """(6,) float64, on the host."""
        return torch.from_numpy(self.sums.b[0])
