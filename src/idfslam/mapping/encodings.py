"""NeRF's positional encoding gamma: coordinates become sines and cosines of doubling frequency."""

import math

import torch
from torch import Tensor, nn


class PositionalEncoding(nn.Module):
    """gamma(x) = (x', sin(2 pi x / L), cos(2 pi x / L), sin(4 pi x / L), ..., cos(2^(n-1) 2 pi x / L)), each coordinate by itself.

    `wavelength` L is the longest wavelength, in the unit of the input. NeRF scales its scene into [-1, 1] and uses L = 2. A SLAM system
    does not know the scene's extent, so L is fixed in metres. 10 m spans a room, and the shortest of eight wavelengths is then
    10 m / 2^7 = 8 cm, below the 10 cm in which the T-SDF goes from 1 to 0. Beyond L the waves repeat, but the raw coordinate x' = 2 x / L
    (in [-1, 1] over one wavelength about the origin) distinguishes the repetitions. For unit view directions use L = 2, as NeRF does.
    """

    angular: Tensor  # (n,) angular frequencies

    def __init__(self, frequencies: int, include_input: bool = True, *, wavelength: float = 10.0) -> None:
        super().__init__()
        self.wavelength = wavelength
        self.include_input = include_input
        self.out_dim = 3 * (2 * frequencies + include_input)
        self.register_buffer("angular", 2 * math.pi / wavelength * 2.0 ** torch.arange(frequencies), persistent=False)

    def forward(self, points: Tensor) -> Tensor:
        """(..., 3) [unit of `wavelength`] -> (..., out_dim)."""
        phases = (points[..., None, :] * self.angular[:, None]).flatten(-2)  # (..., n * 3)
        parts = [phases.sin(), phases.cos()]
        if self.include_input:
            parts.insert(0, points * (2 / self.wavelength))
        return torch.cat(parts, -1)
