"""The pinhole camera: axes x right, y down, z forward; pixel centres at integer coordinates; depth is z-depth [m].

Rays have z = 1, so that the parameter along a ray is the depth.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.errors import ConfigError


@dataclass(frozen=True)
class Camera:
    """Size [px], focal lengths and principal point [px] of an undistorted image.

    Raises ConfigError unless the size is of positive integers, the focal lengths are positive, and all values are finite.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.generic):  # as an entry of a matrix is; the same number of Python's own is what files and texts expect
                object.__setattr__(self, name, value.item())
        for name in ("width", "height"):
            if not (isinstance(value := getattr(self, name), int | np.integer) and not isinstance(value, bool) and value > 0):
                raise ConfigError(f"camera: {name} is {value!r}, expected pixels, an integer above 0")
        for name, positive in (("fx", True), ("fy", True), ("cx", False), ("cy", False)):
            value = getattr(self, name)
            if not isinstance(value, int | float | np.number) or not math.isfinite(value) or (positive and value <= 0):
                expected = "a finite number above 0" if positive else "a finite number"
                raise ConfigError(f"camera: {name} is {value!r}, expected pixels, {expected}")

    def resized(self, width: int, height: int) -> "Camera":
        """The same camera for the image scaled to `width` x `height`; the image's outer edges stay where they are."""
        x, y = width / self.width, height / self.height
        return Camera(width, height, self.fx * x, self.fy * y, (self.cx + 0.5) * x - 0.5, (self.cy + 0.5) * y - 0.5)

    def every(self, step: int) -> "Camera":
        """The camera of every `step`-th pixel along each axis, from pixel `step // 2` on."""
        first = step // 2
        size = len(range(first, self.width, step)), len(range(first, self.height, step))
        return Camera(*size, self.fx / step, self.fy / step, (self.cx - first) / step, (self.cy - first) / step)

    def matrix(self) -> Tensor:
        """K (3, 3) float64."""
        return torch.tensor([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=torch.float64)

    def pixels(self, device: torch.device | str = "cpu") -> Tensor:
        """The coordinates (u, v) of all pixel centres, (H, W, 2) float32."""
        v, u = torch.meshgrid(
            torch.arange(self.height, dtype=torch.float32, device=device),
            torch.arange(self.width, dtype=torch.float32, device=device),
            indexing="ij",
        )
        return torch.stack([u, v], -1)

    def rays(self, uv: Tensor) -> Tensor:
        """Ray directions (..., 3) with z = 1 through pixels (..., 2)."""
        u, v = uv.unbind(-1)
        return torch.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, torch.ones_like(u)], -1)

    def backproject(self, depth: Tensor) -> Tensor:
        """The points (H, W, 3) [m] in the camera's frame of a depth image (H, W) [m]; zeros where there is no depth."""
        pixels = self.pixels(depth.device)
        return self.rays(pixels.to(torch.promote_types(pixels.dtype, depth.dtype))).to(depth.dtype) * depth[..., None]

    def project(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Projects points (..., 3) [m] in the camera's frame to pixels (..., 2) and z (...) [m]; meaningful where z > 0."""
        x, y, z = points.unbind(-1)
        safe = torch.where(z.abs() < 1e-9, torch.full_like(z, 1e-9), z)
        return torch.stack([x / safe * self.fx + self.cx, y / safe * self.fy + self.cy], -1), z

    def inside(self, uv: Tensor, z: Tensor) -> Tensor:
        """Whether projections, pixels (..., 2) and z (...) [m], lie in front of the camera and within the image's outer edges."""
        u, v = uv.unbind(-1)
        return (z > 0) & (u >= -0.5) & (u < self.width - 0.5) & (v >= -0.5) & (v < self.height - 0.5)

    def frustum(self) -> NDArray[np.float64]:
        """(5, 3) inward normals of the planes through the camera's centre that bound what it sees, not of unit length.

        A point in the camera's frame with which all of them have a positive product is `inside`.
        """
        left, top = self.cx + 0.5, self.cy + 0.5
        right, bottom = self.width - left, self.height - top
        return np.array([[0, 0, 1], [self.fx, 0, left], [-self.fx, 0, right], [0, self.fy, top], [0, -self.fy, bottom]], np.float64)


def indices_by_camera(cameras: Sequence[Camera]) -> dict[Camera, list[int]]:
    """Each camera that occurs, in the order of its first occurrence, with the indices where it stands."""
    found: dict[Camera, list[int]] = {}
    for i, camera in enumerate(cameras):
        found.setdefault(camera, []).append(i)
    return found
