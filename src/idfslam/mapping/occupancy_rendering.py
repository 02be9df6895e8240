"""Volume rendering of occupancy along rays: where they end, depth with its variance, and colour (iMAP, Sec. 3.2; NICE-SLAM, Sec. 3.2).

Ray directions have z = 1 in the camera's frame, so the parameter along a ray is depth [m]. All functions are differentiable in the rays.
"""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.mapping.surface_field import SurfaceField
from idfslam.mapping.tsdf_rendering import importance_depths, stratified_depths

_OPEN = 1e10  # [m] length of the last sample of a ray: what is dense there ends the ray. It is NeRF's. Less: rays may pass through
_FLOOR = 1e-10  # [1] least share of light behind a sample, so that products have gradients (NICE-SLAM's code). More: walls shine through
# [1] End of the rays, over the farthest reading of a step (NICE-SLAM's code). More: coarser samples, and more of them behind surfaces
_PAST = 1.2
_BEGIN = 0.01  # [1] first sample of a ray, over its depth (NICE-SLAM's code). More: the space close to the camera is not learnt
_AROUND = 0.05  # [1] reach of the samples near the surface on both sides, over its depth (NICE-SLAM's code). More: coarser, safer
_LEAST = 1.0  # [m] end of the rays at least, for images without a reading. More: coarser samples there. Chosen by hand


Occupancy = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""Points (N, 3) [m], lengths (N,) [m] of the ray that each stands for -> occupancy (N,) in [0, 1], colour (N, 3)."""


class OccupancyField(SurfaceField):
    """A field that says how likely a ray ends at a sample."""

    @abstractmethod
    def occupancy(self, points: Tensor, steps: Tensor) -> tuple[Tensor, Tensor]:
        """An `Occupancy` function."""


@dataclass(frozen=True)
class RenderedRays:
    """B rendered rays with S samples each, in order of depth."""

    colour: Tensor  # (B, 3) expectation
    depth: Tensor  # (B,) expectation [m]
    variance: Tensor  # (B,) of the depth [m^2]
    weights: Tensor  # (B, S) probability that the ray ends at each sample; their sum is at most 1
    depths: Tensor  # (B, S) [m]


def occupancy_of_density(density: Tensor, steps: Tensor) -> Tensor:
    """o = 1 - exp(-rho delta): the occupancy of volume density rho [1/m] over lengths delta [m], of any shape (iMAP, Sec. 3.2)."""
    return 1 - torch.exp(-density * steps)


def termination(occupancy: Tensor) -> Tensor:
    """w_i = o_i prod_{j<i} (1 - o_j): the probability (B, S) that a ray ends at each sample, from occupancies (B, S) in order of depth."""
    passed = torch.cumprod(1 - occupancy + _FLOOR, 1)
    return occupancy * torch.cat([torch.ones_like(passed[:, :1]), passed[:, :-1]], 1)


def composite(occupancy: Tensor, colour: Tensor, depths: Tensor) -> RenderedRays:
    """Rays from occupancies (B, S) and colours (B, S, 3) at depths (B, S) [m]: expectations, and the variance sum_i w_i (d_i - D)^2."""
    weights = termination(occupancy)
    depth = (weights * depths).sum(1)
    variance = (weights * (depths - depth[:, None]).square()).sum(1)
    return RenderedRays((weights[..., None] * colour).sum(1), depth, variance, weights, depths)


def sample_lengths(depths: Tensor, directions: Tensor) -> Tensor:
    """The lengths (B, S) [m] of ray that samples at `depths` (B, S) [m] stand for: up to the next sample, the last one to infinity."""
    steps = torch.cat([depths[:, 1:] - depths[:, :-1], torch.full_like(depths[:, :1], _OPEN)], 1)
    return steps * directions.norm(dim=-1, keepdim=True)


def volume_render(occupancy_at: Occupancy, origins: Tensor, directions: Tensor, depths: Tensor) -> RenderedRays:
    """Rays (B, 3), (B, 3) through occupied space, sampled at `depths` (B, S) [m]."""
    points = origins[:, None] + directions[:, None] * depths[..., None]
    occupancy, colour = occupancy_at(points.reshape(-1, 3), sample_lengths(depths, directions).reshape(-1))
    return composite(occupancy.view(depths.shape), colour.view(*depths.shape, 3), depths)


def farthest_sample(readings: Tensor) -> Tensor:
    """The depth [m], a number, at which all rays of a step end: 1.2 times their farthest reading (B,), as in NICE-SLAM's code."""
    return (readings.max() * _PAST).clamp(min=_LEAST)


def hierarchical_depths(
    occupancy_at: Occupancy, origins: Tensor, directions: Tensor, far: Tensor, coarse: int, fine: int, generator: torch.Generator | None
) -> Tensor:
    """Depths (B, coarse + fine) [m] up to `far` (a number): stratified ones, and others drawn from the weights that these render with.

    It is NeRF's scheme, and iMAP's. Without a generator the depths are evenly spread.
    """
    with torch.no_grad():
        depths = stratified_depths(0.0, far.expand(len(origins)), coarse, generator)
        weights = volume_render(occupancy_at, origins, directions, depths).weights
        return torch.cat([depths, importance_depths(depths, weights, fine, generator)], 1).sort(1).values


def near_surface_depths(readings: Tensor, far: Tensor, stratified: int, near: int) -> Tensor:
    """Depths (B, stratified + near) [m]: evenly from 1 % of the reading (B,) [m] to `far`, and within 5 % of the reading.

    They are those of NICE-SLAM's code. A ray without a reading (0) has the latter evenly from the camera to the farthest reading.
    """
    share = torch.linspace(0, 1, stratified, device=readings.device, dtype=readings.dtype)
    along = _BEGIN * readings[:, None] * (1 - share) + far * share
    if not near:
        return along
    share, measured = torch.linspace(0, 1, near, device=readings.device, dtype=readings.dtype), readings[:, None] > 0
    around = readings[:, None] * (1 + _AROUND * (2 * share - 1))
    return torch.cat([along, torch.where(measured, around, readings.max() * share)], 1).sort(1).values
