"""Gaussian Fourier features of a position (Tancik et al. 2020), with a matrix that is learnt, as in iMAP and NICE-SLAM."""

import torch
from torch import Tensor, nn


class FourierFeatures(nn.Module):
    """gamma(p) = sin(B p / unit) with B (n, 3), whose entries are drawn from N(0, deviation^2) and then learnt (iMAP, Sec. 3.1)."""

    def __init__(self, features: int, deviation: float, unit: float = 1.0) -> None:
        """unit: length [m] that counts as 1. deviation: [rad] a unit. More of it, or a shorter unit: finer detail, and less smoothness."""
        super().__init__()
        self.unit, self.out_dim = unit, features
        self.B = nn.Parameter(torch.randn(features, 3) * deviation)

    def forward(self, points: Tensor) -> Tensor:
        """Points (N, 3) [m] -> (N, features)."""
        return torch.sin((points / self.unit) @ self.B.T)
