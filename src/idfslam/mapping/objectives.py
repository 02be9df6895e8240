"""What the map is taught from: volume rendering as in the paper, or the samples themselves."""

from typing import Protocol

import torch
from torch import Tensor

from idfslam.config import MapperConfig
from idfslam.mapping.field import Field
from idfslam.mapping.losses import Losses, LossWeights, rendering_losses, sample_losses
from idfslam.mapping.rays import Rays
from idfslam.mapping.rendering import RayMarch, render, stratified_depths


class Objective(Protocol):
    """A loss of the field over rays; differentiable in the field's weights and in the rays (so in their poses)."""

    def __call__(self, field: Field, rays: Rays, generator: torch.Generator) -> Losses: ...


def loss_weights(config: MapperConfig) -> LossWeights:
    """The weights of Eqs. 2 and 3 as configured."""
    return LossWeights(config.photometric_weight, config.free_space_weight, config.truncation_weight)


class RenderingObjective:
    """Eqs. 1-3 on rendered rays (Sec. IV-A); used for the map and, with the map frozen, for poses (Eq. 4)."""

    def __init__(self, config: MapperConfig, truncation: float) -> None:
        self.weights = loss_weights(config)
        self.march = RayMarch(config.samples, config.importance_samples, truncation, config.sharpness)

    def __call__(self, field: Field, rays: Rays, generator: torch.Generator) -> Losses:
        far = far_depth(rays, self.march.truncation)
        rendered = render(field, rays.origins, rays.directions, far, self.march, generator=generator)
        return rendering_losses(rendered, rays.colour, rays.depth, self.march.truncation, self.weights)


def far_depth(rays: Rays, truncation: float) -> Tensor:
    """Where to stop (B,) [m]: twice the truncation behind the measured surface; without a reading, behind the farthest of all."""
    farthest = rays.depth.max().clamp(min=1.0)
    return torch.where(rays.depth > 0, rays.depth, farthest) + 2 * truncation


import os
EXPO = float(os.environ.get("EXPO", "0.5"))


class SampleObjective:
    """T-SDF and colour held against the measurement at the samples themselves: few of them, near the surface and in free space.

    Near the surface the target is the distance to the tangent plane, `Rays.facing` a metre of depth, not the distance along the ray.
    In free space the measurement bounds the distance from below alone: other surfaces may be nearer than the one ahead.
    """

    def __init__(self, config: MapperConfig, truncation: float) -> None:
        self.config, self.truncation = config, truncation

    def __call__(self, field: Field, rays: Rays, generator: torch.Generator) -> Losses:
        c, tr = self.config, self.truncation
        depth = rays.depth[:, None]
        span = torch.full_like(rays.depth, 2 * tr)
        near = depth - tr + stratified_depths(0.0, span, c.samples, generator)
        near[:, 0] = rays.depth
        free = stratified_depths(0.05, (rays.depth - tr).clamp(min=0.1), c.importance_samples, generator)
        sdf, colour = field(_points(rays, near))
        free_sdf = field.sdf(_points(rays, free)).view(free.shape)
        target = ((depth - near) * rays.facing[:, None] / tr).clamp(-1, 1)
        certainty = 1 / noise_ratio(rays.depth)
        residual = (sdf.view(near.shape) - target) * certainty[:, None] ** EXPO
        truncation_term = (residual**2).mean(1)
        free_term = torch.relu(c.free_margin - free_sdf).square().mean(1)
        colour_term = (colour.view(*near.shape, 3) - rays.colour[:, None]).abs().mean((1, 2))
        per_ray = c.truncation_weight * truncation_term + c.free_space_weight * free_term + c.photometric_weight * colour_term
        return Losses(per_ray.mean(), colour_term.mean(), free_term.mean(), truncation_term.mean(), per_ray.detach())


def _points(rays: Rays, depths: Tensor) -> Tensor:
    """(B, S) depths along the rays -> (B * S, 3)."""
    return (rays.origins[:, None] + rays.directions[:, None] * depths[..., None]).reshape(-1, 3)


def noise_ratio(depth: Tensor) -> Tensor:
    """Noise of a depth reading [m] as a multiple of the sensor's best: structured light and stereo lose with the square of depth."""
    return 1 + 1.5 * (depth - 0.4).clamp(min=0) ** 2
