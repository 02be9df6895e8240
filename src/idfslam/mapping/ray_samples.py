"""Samples along rays with their target values, near the surface and in free space."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from idfslam.compute.backend import pick
from idfslam.mapping.constants import FREE_FROM, FREE_TO
from idfslam.mapping.rays import Rays


@dataclass(frozen=True)
class RaySamples:
    """N samples along B rays with their targets. The first `near` are near the surface, the others in free space."""

    points: Tensor  # (N, 3) [m]
    near: int  # B * S of the N samples
    target: Tensor  # (N,) T-SDF [tr]; unused in free space
    weight: Tensor  # (N,) of the T-SDF's squared residual; each class's weights sum to the weight of its loss
    colour: Tensor  # (near, 3) in [0, 1]
    colour_weight: Tensor  # (near,) of the colour's absolute residual


def uniform(like: Tensor, rays: int, samples: int, generator: torch.Generator) -> Tensor:
    """Random numbers (rays, samples) in [0, 1), drawn on the generator's device, of the dtype and device of `like`."""
    return torch.rand(rays, samples, generator=generator, device=generator.device).to(like)


def sample_points(rays: Rays, jitter: Tensor, free_jitter: Tensor, truncation: float) -> tuple[Tensor, Tensor]:
    """Stratified samples on B rays: points (B * (S + S'), 3) and their target T-SDF [tr], which is 1 in free space.

    S samples of each ray lie within `truncation` of the surface, in front of it and behind it: samples on one side alone would shift the
    surface when readings are noisy. S' samples lie in front of these. jitter (B, S) and free_jitter (B, S') in [0, 1) place each sample
    within its stratum.
    """
    gradients = rays.origins.requires_grad or rays.directions.requires_grad  # the kernel computes none
    place = plain_sample_points if gradients else pick(rays.depth, compiled=compiled_sample_points, plain=plain_sample_points)
    return place(rays, jitter, free_jitter, truncation)


def plain_sample_points(rays: Rays, jitter: Tensor, free_jitter: Tensor, truncation: float) -> tuple[Tensor, Tensor]:
    """`sample_points` in torch, on any device."""
    depth = rays.depth[:, None]
    near = depth - truncation + 2 * truncation * stratified(jitter)
    first, last = FREE_FROM, (depth - truncation).clamp(min=FREE_TO)
    free = first + (last - first) * stratified(free_jitter)
    target = ((depth - near) * rays.cos_incidence[:, None] / truncation).clamp(-1, 1).flatten()
    return torch.cat([_points(rays, near), _points(rays, free)]), torch.cat([target, torch.ones_like(free).flatten()])


def stratified(jitter: Tensor) -> Tensor:
    """Stratified positions (B, S) in [0, 1): one in each of S equal strata, at `jitter` (B, S) within it."""
    samples = jitter.shape[1]
    return (torch.arange(samples, dtype=jitter.dtype, device=jitter.device) + jitter) / samples


def compiled_sample_points(rays: Rays, jitter: Tensor, free_jitter: Tensor, truncation: float) -> tuple[Tensor, Tensor]:
    """`sample_points` by Numba, on the CPU, without gradients."""
    from idfslam.mapping.kernels import numba_rays

    points = torch.empty(jitter.numel() + free_jitter.numel(), 3)
    target = torch.empty(len(points))
    along = [t.contiguous().numpy() for t in (rays.origins, rays.directions, rays.depth, rays.cos_incidence)]
    outputs = points.numpy(), target.numpy()
    numba_rays.place(*along, jitter.numpy(), free_jitter.numpy(), np.float32(truncation), *outputs)  # type: ignore[call-arg]
    return points, target


def _points(rays: Rays, depths: Tensor) -> Tensor:
    """Points (B * S, 3) at depths (B, S) along the rays."""
    return (rays.origins[:, None] + rays.directions[:, None] * depths[..., None]).reshape(-1, 3)
