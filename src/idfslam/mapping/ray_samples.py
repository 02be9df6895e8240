"""Points along rays, with what the field should say there: near the surface and in free space."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from idfslam.compute.backend import pick
from idfslam.mapping.constants import FREE_FROM, FREE_TO
from idfslam.mapping.rays import Rays


@dataclass(frozen=True)
class RaySamples:
    """Points along B rays with what the field should say there; the first `near` are about the surface, the rest in free space."""

    points: Tensor  # (N, 3) [m]
    near: int  # B * S of the N points
    target: Tensor  # (N,) T-SDF [tr]; in free space: unused
    weight: Tensor  # (N,) of the T-SDF's residual; they sum to the share of their loss
    colour: Tensor  # (near, 3)
    colour_weight: Tensor  # (near,)


def uniform(like: Tensor, rays: int, samples: int, generator: torch.Generator) -> Tensor:
    """(rays, samples) in [0, 1) of the generator's device and then of the tensor's."""
    return torch.rand(rays, samples, generator=generator, device=generator.device).to(like)


def placed(rays: Rays, chance: Tensor, free_chance: Tensor, truncation: float) -> tuple[Tensor, Tensor]:
    """Points (B * (S + S'), 3) on B rays and their T-SDF [tr], as far as it is known: in free space 1.

    S of each ray lie within `truncation` of the surface, as far before it as behind: one-sided they would move the surface as soon as
    readings are noisy. S' lie before that. Each is in its own part of the way, where chance (B, S) and free_chance (B, S') say.
    """
    gradients = rays.origins.requires_grad or rays.directions.requires_grad  # the kernel has none
    place = plain_placed if gradients else pick(rays.depth, compiled=compiled_placed, plain=plain_placed)
    return place(rays, chance, free_chance, truncation)


def plain_placed(rays: Rays, chance: Tensor, free_chance: Tensor, truncation: float) -> tuple[Tensor, Tensor]:
    """`placed` in torch, on any device."""
    depth = rays.depth[:, None]
    near = depth - truncation + 2 * truncation * parts(chance)
    first, last = FREE_FROM, (depth - truncation).clamp(min=FREE_TO)
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
