"""Vignetting: a lens gives less light to a pixel the farther it lies from the principal point.

The logarithm of the share that arrives is an even polynomial of the radius, V(r) = exp(a r^2 + b r^4). That is 1 + a r^2 + ... to first
order, is positive everywhere, and makes the unknowns linear in the logarithms of colours, in which exposure is linear too.
"""

from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

from idfslam.geometry.camera import Camera

TERMS = 2  # number of even powers of the radius, r^2 and r^4; more: steeper corners are followed, and noise too. Chosen by hand


@dataclass(frozen=True)
class Vignette:
    """The vignetting of one recording. The radius is 1 at half the image's diagonal from the principal point."""

    coefficients: tuple[float, ...] = (0.0,) * TERMS  # of the even powers of the radius, r^2 first [1]

    def share(self, uv: Tensor, camera: Camera) -> Tensor:
        """The share (N,) of the light that arrives at pixels (N, 2)."""
        return (even_powers(uv, camera) @ uv.new_tensor(self.coefficients)).exp()

    def image(self, camera: Camera) -> Tensor:
        """The share (H, W) float32 of the light that arrives at each pixel, on the CPU. It is computed once, and not to be changed."""
        return _image(self, camera)

    @property
    def corner(self) -> float:
        """The share of the light that arrives at radius 1."""
        return float(torch.tensor(self.coefficients).sum().exp())


@lru_cache(maxsize=4)
def _image(vignette: Vignette, camera: Camera) -> Tensor:
    return vignette.share(camera.pixels().flatten(0, 1), camera).view(camera.height, camera.width)


def even_powers(uv: Tensor, camera: Camera) -> Tensor:
    """r^2, r^4 ... (N, TERMS) of pixels (N, 2)."""
    half_diagonal_squared = (camera.width**2 + camera.height**2) / 4
    r2 = ((uv - uv.new_tensor([camera.cx, camera.cy])) ** 2).sum(-1) / half_diagonal_squared
    return torch.stack([r2 ** (k + 1) for k in range(TERMS)], -1)
