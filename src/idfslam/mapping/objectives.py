"""What the map is taught from: volume rendering as in the paper, or the samples themselves."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from idfslam.config import MapperConfig
from idfslam.hardware import repeatable
from idfslam.mapping.field import Field
from idfslam.mapping.fused import fusable
from idfslam.mapping.fused import learn as fused_learn
from idfslam.mapping.fused import learn_steps as fused_steps
from idfslam.mapping.losses import Losses, LossWeights, rendering_losses
from idfslam.mapping.optimiser import MapOptimiser
from idfslam.mapping.rays import Rays
from idfslam.mapping.rendering import RayMarch, render


class Objective(Protocol):
    """A loss of the field over rays."""

    def __call__(self, field: Field, rays: Rays, generator: torch.Generator) -> Losses:
        """Differentiable in the field's weights and in the rays (so in their poses)."""
        ...

    def learn(self, field: Field, rays: Rays, generator: torch.Generator) -> Losses:
        """The loss, its gradients added to the field's."""
        ...


def loss_weights(config: MapperConfig) -> LossWeights:
    """The weights of Eqs. 2 and 3 as configured."""
    return LossWeights(config.photometric_weight, config.free_space_weight, config.truncation_weight, squared=config.squared)


class RenderingObjective:
    """Eqs. 1-3 on rendered rays (Sec. IV-A); used for the map and, with the map frozen, for poses (Eq. 4)."""

    def __init__(self, config: MapperConfig, truncation: float) -> None:
        self.weights = loss_weights(config)
        self.march = RayMarch(config.samples, config.importance_samples, truncation, config.sharpness)

    def __call__(self, field: Field, rays: Rays, generator: torch.Generator) -> Losses:
        far = far_depth(rays, self.march.truncation)
        rendered = render(field, rays.origins, rays.directions, far, self.march, generator=generator)
        return rendering_losses(rendered, rays.colour, rays.depth, self.march.truncation, self.weights)

    def learn(self, field: Field, rays: Rays, generator: torch.Generator) -> Losses:
        """The loss, its gradients added to the field's."""
        losses = self(field, rays, generator)
        with repeatable(losses.total.device):
            losses.total.backward()
        return losses


def far_depth(rays: Rays, truncation: float) -> Tensor:
    """Where to stop (B,) [m]: twice the truncation behind the measured surface; without a reading, behind the farthest of all."""
    farthest = rays.depth.max().clamp(min=1.0)
    return torch.where(rays.depth > 0, rays.depth, farthest) + 2 * truncation


@dataclass(frozen=True)
class Samples:
    """Points along B rays with what the field should say there; the first `near` are about the surface, the rest in free space."""

    points: Tensor  # (N, 3) [m]
    near: int  # B * S of the N points
    target: Tensor  # (N,) T-SDF [tr]; in free space: unused
    weight: Tensor  # (N,) of the T-SDF's residual; they sum to the share of their loss
    colour: Tensor  # (near, 3)
    colour_weight: Tensor  # (near,)


class SampleObjective:
    """T-SDF and colour held against the measurement at the samples themselves: few of them, near the surface and in free space.

    Near the surface the target is the distance to the tangent plane, `Rays.facing` a metre of depth, not the distance along the ray.
    In free space the measurement bounds the distance from below alone: other surfaces may be nearer than the one ahead.
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
        """The loss, its gradients added to the field's; fused where the field allows."""
        if fusable(field):
            samples = self.samples(rays, generator)
            terms, colour_terms = fused_learn(field, samples, self.config.free_margin)
            return self._losses(samples.near, len(rays), terms, colour_terms)
        losses = self(field, rays, generator)
        with repeatable(losses.total.device):
            losses.total.backward()
        return losses

    def samples(self, rays: Rays, generator: torch.Generator) -> Samples:
        """S near the surface and S' in free space, of each ray."""
        c = self.config
        like = rays.depth
        chance, free_chance = (uniform(like, len(rays), number, generator) for number in (c.samples, c.importance_samples))
        plain = like.device.type != "cpu" or rays.origins.requires_grad or rays.directions.requires_grad
        points, target = (placed if plain else compiled_placed)(rays, chance, free_chance, self.truncation)
        near, free = chance.numel(), free_chance.numel()
        weight = like.new_full((near + free,), c.free_space_weight / max(free, 1))
        weight[:near] = c.truncation_weight / near
        if c.certainty:
            certainty = noise_ratio(rays.depth) ** -c.certainty
            weight[:near] *= (certainty / certainty.mean().clamp(min=1e-6)).repeat_interleave(c.samples)
        colour = rays.colour[:, None].expand(-1, c.samples, 3).reshape(-1, 3)
        return Samples(points, near, target, weight, colour, like.new_full((near,), c.photometric_weight / near))

    def steps(self, field: Field, optimiser: MapOptimiser, rays: Rays, steps: int, generator: torch.Generator) -> list[Losses]:
        """So many steps of the optimiser, each on the rays of its turn; for fields that `fused.learns_in_steps`."""
        learnt = fused_steps(field, optimiser, rays, steps, self.config, generator)
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


def uniform(like: Tensor, rays: int, samples: int, generator: torch.Generator) -> Tensor:
    """(rays, samples) in [0, 1) of the generator's device and then of the tensor's."""
    return torch.rand(rays, samples, generator=generator, device=generator.device).to(like)


def placed(rays: Rays, chance: Tensor, free_chance: Tensor, truncation: float) -> tuple[Tensor, Tensor]:
    """Points (B * (S + S'), 3) on B rays and their T-SDF [tr], as far as it is known: in free space 1.

    S of each ray lie within `truncation` of the surface, as far before it as behind: one-sided they would move the surface as soon as
    readings are noisy. S' lie before that. Each is in its own part of the way, where chance (B, S) and free_chance (B, S') say.
    """
    depth = rays.depth[:, None]
    near = depth - truncation + 2 * truncation * parts(chance)
    first, last = 0.05, (depth - truncation).clamp(min=0.1)
    free = first + (last - first) * parts(free_chance)
    target = ((depth - near) * rays.facing[:, None] / truncation).clamp(-1, 1).flatten()
    return torch.cat([_points(rays, near), _points(rays, free)]), torch.cat([target, torch.ones_like(free).flatten()])


def parts(chance: Tensor) -> Tensor:
    """Places in [0, 1) of S samples (B, S), one in each of S equal parts."""
    samples = chance.shape[1]
    return (torch.arange(samples, dtype=chance.dtype, device=chance.device) + chance) / samples


def compiled_placed(rays: Rays, chance: Tensor, free_chance: Tensor, truncation: float) -> tuple[Tensor, Tensor]:
    """`placed` by Numba, on the CPU, without gradients."""
    from idfslam.mapping.kernels import numba_rays

    points = torch.empty(chance.numel() + free_chance.numel(), 3)
    target = torch.empty(len(points))
    along = [t.contiguous().numpy() for t in (rays.origins, rays.directions, rays.depth, rays.facing)]
    outputs = points.numpy(), target.numpy()
    numba_rays.place(*along, chance.numpy(), free_chance.numpy(), np.float32(truncation), *outputs)  # type: ignore[call-arg]
    return points, target


def _points(rays: Rays, depths: Tensor) -> Tensor:
    """(B, S) depths along the rays -> (B * S, 3)."""
    return (rays.origins[:, None] + rays.directions[:, None] * depths[..., None]).reshape(-1, 3)


def noise_ratio(depth: Tensor) -> Tensor:
    """Noise of a depth reading [m] as a multiple of the sensor's best: structured light and stereo lose with the square of depth."""
    return 1 + 1.5 * (depth - 0.4).clamp(min=0) ** 2
