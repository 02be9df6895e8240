"""The training objectives of the map: volume rendering as in the paper, or direct supervision of samples."""

from typing import Protocol

import torch
from torch import Tensor

from idfslam.compute.devices import repeatable
from idfslam.config import MapperConfig
from idfslam.mapping.compiled_field import compilable
from idfslam.mapping.compiled_field import learn as compiled_learn
from idfslam.mapping.compiled_field import learn_steps as compiled_steps
from idfslam.mapping.field import Field
from idfslam.mapping.losses import Losses, LossWeights, rendering_losses
from idfslam.mapping.optimiser import MapOptimiser
from idfslam.mapping.ray_samples import RaySamples, sample_points, uniform
from idfslam.mapping.rays import Rays
from idfslam.mapping.tsdf_rendering import RayMarch, render


class Objective(Protocol):
    """A loss of the field over rays."""

    def __call__(self, field: Field, rays: Rays, generator: torch.Generator) -> Losses:
        """The loss, differentiable in the field's weights and in the rays, and so in their poses."""
        ...

    def learn(self, field: Field, rays: Rays, generator: torch.Generator) -> Losses:
        """Adds the gradients of the loss to the field's; returns the loss."""
        ...


def loss_weights(config: MapperConfig) -> LossWeights:
    """The weights of Eqs. 2 and 3 as configured."""
    return LossWeights(config.photometric_weight, config.free_space_weight, config.truncation_weight)


class RenderingObjective:
    """Eqs. 1-3 on rendered rays (Sec. IV-A), for the map and, with the map frozen, for poses (Eq. 4)."""

    def __init__(self, config: MapperConfig, truncation: float) -> None:
        self.weights = loss_weights(config)
        self.march = RayMarch(config.samples, config.importance_samples, truncation, config.sharpness)

    def __call__(self, field: Field, rays: Rays, generator: torch.Generator) -> Losses:
        far = far_depth(rays, self.march.truncation)
        rendered = render(field, rays.origins, rays.directions, far, self.march, generator=generator)
        return rendering_losses(rendered, rays.colour, rays.depth, self.march.truncation, self.weights)

    def learn(self, field: Field, rays: Rays, generator: torch.Generator) -> Losses:
        """Adds the gradients of the loss to the field's; returns the loss."""
        losses = self(field, rays, generator)
        with repeatable(losses.total.device):
            losses.total.backward()
        return losses


def far_depth(rays: Rays, truncation: float) -> Tensor:
    """Depths (B,) [m] at which rays end: twice the truncation behind the measured surface, or, without a reading, behind the farthest."""
    farthest = rays.depth.max().clamp(min=1.0)
    return torch.where(rays.depth > 0, rays.depth, farthest) + 2 * truncation


class SampleObjective:
    """Direct supervision of T-SDF and colour at samples on the rays: few of them, near the surface and in free space.

    Near the surface the target is the distance to the tangent plane: `Rays.cos_incidence` times the distance along the ray. In free space
    the prediction is only bounded from below (`free_margin`), since other surfaces may be nearer than the one along the ray.
    """

    def __init__(self, config: MapperConfig, truncation: float) -> None:
        self.config, self.truncation = config, truncation

    def __call__(self, field: Field, rays: Rays, generator: torch.Generator) -> Losses:
        samples = self.samples(rays, generator)
        sdf, colour = field(samples.points[: samples.near])
        free_sdf = field.sdf(samples.points[samples.near :])
        residual = torch.cat([sdf - samples.target[: samples.near], (free_sdf - self.config.free_margin).clamp(max=0)])
        terms = samples.weight * residual**2
        colour_terms = (colour - samples.colour).abs().mean(-1)
        return self._losses(samples.near, len(rays), terms, colour_terms)

    def learn(self, field: Field, rays: Rays, generator: torch.Generator) -> Losses:
        """Adds the gradients of the loss to the field's; returns the loss. Fused if the field allows it."""
        if compilable(field):
            samples = self.samples(rays, generator)
            terms, colour_terms = compiled_learn(field, samples, self.config.free_margin)
            return self._losses(samples.near, len(rays), terms, colour_terms)
        losses = self(field, rays, generator)
        with repeatable(losses.total.device):
            losses.total.backward()
        return losses

    def samples(self, rays: Rays, generator: torch.Generator) -> RaySamples:
        """S samples near the surface and S' in free space on each ray."""
        c = self.config
        like = rays.depth
        jitter, free_jitter = (uniform(like, len(rays), number, generator) for number in (c.samples, c.importance_samples))
        points, target = sample_points(rays, jitter, free_jitter, self.truncation)
        near, free = jitter.numel(), free_jitter.numel()
        weight = like.new_full((near + free,), c.free_space_weight / max(free, 1))
        weight[:near] = c.truncation_weight / near
        colour = rays.colour[:, None].expand(-1, c.samples, 3).reshape(-1, 3)
        return RaySamples(points, near, target, weight, colour, like.new_full((near,), c.photometric_weight / near))

    def steps(self, field: Field, optimiser: MapOptimiser, rays: Rays, steps: int, generator: torch.Generator) -> list[Losses]:
        """`steps` steps of the optimiser, step i on every `steps`-th ray from i on; for fields with `compiled_field.learns_in_steps`."""
        learnt = compiled_steps(field, optimiser, rays, steps, self.config, generator)
        count = len(rays) // steps
        return [self._losses(learnt.near, count, *terms) for terms in zip(learnt.terms, learnt.colour_terms)]

    def _losses(self, near: int, rays: int, terms: Tensor, colour_terms: Tensor) -> Losses:
        near_terms, free = terms[:near], terms[near:]
        photometric = self.config.photometric_weight / near * colour_terms
        per_ray = (near_terms + photometric).view(rays, -1).sum(1) + free.view(rays, -1).sum(1)
        c = self.config
        return Losses(
            total=per_ray.sum(),
            photometric=photometric.sum() / c.photometric_weight,
            free_space=free.sum() / c.free_space_weight,
            truncation=near_terms.sum() / c.truncation_weight,
            per_ray=per_ray.detach() * rays,
        )
