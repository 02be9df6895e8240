"""A depth sensor's smooth error: a factor on its readings that changes over the image and with depth (Teichman et al., RSS 2013)."""

from dataclasses import astuple, dataclass, fields

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REFERENCE = 2.0  # [m] depth at which the deformation with range is zero; raised, the same numbers mean a smaller scale. Chosen by hand: the
#    middle of the range of indoor sensors


@dataclass(frozen=True)
class DepthDeformation:
    """A reading z at (x, y) stands for z (1 + range (z / 2 m - 1) + across x + along y + across2 (x^2 - 1/3) + along2 (y^2 - 1/3)).

    x and y run from -1 to 1 over the image's width and height. Each term has the mean 0 over the image or at 2 m, so that none changes
    the scale of depth. `range` is the first order of an offset in disparity, the others are those of lenses and their tilt.
    """

    range: float = 0.0  # [1], like the others
    across: float = 0.0
    along: float = 0.0
    across2: float = 0.0
    along2: float = 0.0

    def __bool__(self) -> bool:
        """Whether it changes anything."""
        return any(astuple(self))

    def factors(self, uv: Array, z: Array, size: tuple[int, int]) -> Array:
        """(N,) the factors of readings z (N,) [m] at pixels uv (N, 2) of images of a size (width, height)."""
        return 1 + terms(uv, z, size) @ np.array(astuple(self))

    def corrected(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Depth (H, W) [m] without the deformation; 0 stays 0."""
        height, width = depth.shape
        x, y = _unit(np.arange(width), width), _unit(np.arange(height), height)[:, None]
        over_image = 1 - self.range + self.across * x + self.along * y + self.across2 * (x * x - 1 / 3) + self.along2 * (y * y - 1 / 3)
        return depth * (over_image.astype(np.float32) + np.float32(self.range / REFERENCE) * depth)


NAMES = tuple(field.name for field in fields(DepthDeformation))
"""The names of its numbers, in order."""


def terms(uv: Array, z: Array, size: tuple[int, int]) -> Array:
    """(N, 5) what each number of a deformation is multiplied with, for readings z (N,) [m] at pixels uv (N, 2)."""
    x, y = _unit(uv[:, 0], size[0]), _unit(uv[:, 1], size[1])
    return np.stack([z / REFERENCE - 1, x, y, x * x - 1 / 3, y * y - 1 / 3], 1)


def _unit(pixel: NDArray[np.generic], count: int) -> Array:
    """Coordinates from -1 to 1 over a row of `count` pixels."""
    return (np.asarray(pixel, np.float64) + 0.5) / count * 2 - 1
