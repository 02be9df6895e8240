"""A differentiable renderer of coloured points in plain torch: soft splats, nearest first ([31] uses PyTorch3D)."""

from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.geometry.camera import Camera

_NEAR = 0.05  # points closer than this [m] are not drawn


@dataclass(frozen=True)
class Splats:
    """The rendered image."""

    values: Tensor  # (H, W, C) weighted means of the points' values
    depth: Tensor  # (H, W) of their z [m]
    coverage: Tensor  # (H, W) in [0, 1]: 0 where no point falls


def splat(points: Tensor, values: Tensor, camera: Camera, *, radius: float = 1.5, softness: float = 0.05) -> Splats:
    """Draws points (N, 3) [m] in the camera's frame with values (N, C) as discs of `radius` <= 1.5 pixels.

    A point's weight in a pixel is (1 - r^2/radius^2) exp(-(z - z_front)/softness), so that points more than a few `softness` [m]
    behind the front point of the pixel vanish. Differentiable with respect to points and values.
    """
    uv, z = camera.project(points)
    offsets = torch.tensor([[x, y] for y in (-1, 0, 1) for x in (-1, 0, 1)], device=points.device)
    pixels = uv.detach().round().long()[:, None] + offsets  # (N, 9, 2)
    disc = 1 - (pixels - uv[:, None]).square().sum(-1) / radius**2
    inside = camera.inside(pixels.to(uv), z[:, None].expand(-1, 9)) & (z[:, None] > _NEAR) & (disc > 0)
    point, slot = inside.nonzero(as_tuple=True)
    pixel = pixels[point, slot, 1] * camera.width + pixels[point, slot, 0]
    count = camera.width * camera.height
    front = torch.full((count,), torch.inf, device=z.device, dtype=z.dtype).scatter_reduce(0, pixel, z.detach()[point], "amin")
    weight = disc[point, slot] * torch.exp(-(z[point] - front[pixel]) / softness)
    drawn = torch.cat([values, z[:, None], torch.ones_like(z[:, None])], -1)[point] * weight[:, None]
    total = drawn.new_zeros(count, drawn.shape[1]).index_add(0, pixel, drawn).view(camera.height, camera.width, -1)
    mean = total[..., :-1] / total[..., -1:].clamp(min=1e-6)
    return Splats(mean[..., :-1], mean[..., -1], total[..., -1].clamp(max=1))
