"""Volume rendering of a T-SDF field along camera rays (Sec. III; the renderer of Neural RGB-D Surface Reconstruction [25]).

The field is a callable `field(points (N, 3) [m], directions (N, 3) unit) -> (sdf (N,) in units of the truncation distance, colour (N, 3))`.
Ray directions have z = 1 in the camera's frame, so the parameter along a ray is depth [m]. All functions are differentiable in the rays'
origins and directions; this gives the gradient of a camera pose (Eq. 4).
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from idfslam.geometry.camera import Camera

FieldFunction = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]


@dataclass(frozen=True)
class RayMarch:
    """How rays are sampled and samples are weighted."""

    samples: int  # stratified samples a ray
    importance_samples: int  # further samples a ray, drawn from the weights of the stratified ones
    truncation: float  # tr [m]
    sharpness: float  # s of the bell sigmoid(s D/tr) sigmoid(-s D/tr)
    near: float = 0.05  # depth of the first sample [m]


@dataclass(frozen=True)
class Rendered:
    """B rendered rays with S samples each, in order of depth."""

    colour: Tensor  # (B, 3) in [0, 1]
    depth: Tensor  # (B,) weighted mean of the samples' depths [m]
    sdf: Tensor  # (B, S) in units of tr
    depths: Tensor  # (B, S) [m]
    weights: Tensor  # (B, S), summing to 1


def world_rays(T_wc: Tensor, camera: Camera, uv: Tensor) -> tuple[Tensor, Tensor]:
    """Rays through the pixels uv (B, 2) of cameras T_wc, (4, 4) or one a ray (B, 4, 4): origins and directions, both (B, 3), world frame.

    The directions keep z = 1 in the camera's frame; the dtype is that of the pose.
    """
    rays = camera.rays(uv.to(T_wc.dtype))
    directions = (T_wc[..., :3, :3] @ rays[..., None])[..., 0]
    return T_wc[..., :3, 3].expand_as(directions), directions


def stratified_depths(near: float, far: Tensor, samples: int, generator: torch.Generator | None = None) -> Tensor:
    """Depths (B, samples) [m], one in each of `samples` equal strata of [near, far], far (B,) [m]; without a generator the middles."""
    shape = (far.shape[0], samples)
    jitter = torch.full(shape, 0.5) if generator is None else torch.rand(shape, generator=generator, device=generator.device)
    share = (torch.arange(samples, dtype=far.dtype, device=far.device) + jitter.to(far)) / samples
    return near + (far - near)[:, None] * share


def importance_depths(depths: Tensor, weights: Tensor, samples: int, generator: torch.Generator | None = None) -> Tensor:
    """Depths drawn from the density that `weights` (B, S) at `depths` (B, S) describe, by inverting its CDF -> (B, samples) [m].

    The density is constant between the middles of neighbouring depths. No gradient flows through the choice. Without a generator the
    quantiles are evenly spaced.
    """
    depths, weights = depths.detach(), weights.detach()
    middles = (depths[:, 1:] + depths[:, :-1]) / 2
    edges = torch.cat([depths[:, :1], middles, depths[:, -1:]], 1)  # (B, S + 1)
    mass = weights + 1e-5 / weights.shape[1]  # rays without any weight are sampled evenly
    cdf = F.pad(mass.cumsum(1) / mass.sum(1, keepdim=True), (1, 0))
    quantiles = stratified_depths(0.0, cdf.new_ones(len(cdf)), samples, generator)
    right = torch.searchsorted(cdf, quantiles, right=True).clamp(1, weights.shape[1])
    c0, c1 = cdf.gather(1, right - 1), cdf.gather(1, right)
    e0, e1 = edges.gather(1, right - 1), edges.gather(1, right)
    return e0 + (e1 - e0) * ((quantiles - c0) / (c1 - c0).clamp(min=1e-12)).clamp(0, 1)


def zero_crossing(sdf: Tensor, depths: Tensor) -> Tensor:
    """Depth (B,) [m] of the first change from positive to not positive along rays (B, S), linearly interpolated; inf without one."""
    front, behind = sdf[:, :-1], sdf[:, 1:]
    crosses = (front > 0) & (behind <= 0)
    first = crosses.int().argmax(1, keepdim=True)  # argmax gives the first of equals
    s0, s1 = front.gather(1, first), behind.gather(1, first)
    d0, d1 = depths.gather(1, first), depths.gather(1, first + 1)
    hit = crosses.any(1)
    share = s0 / torch.where(hit[:, None], s0 - s1, torch.ones_like(s0))
    return torch.where(hit, (d0 + (d1 - d0) * share)[:, 0], torch.inf)


def render_weights(sdf: Tensor, depths: Tensor, truncation: float, sharpness: float) -> Tensor:
    """Weights (B, S) of samples with T-SDF `sdf` (B, S) [tr] at `depths` (B, S) [m]: a bell around the surface, summing to 1.

    w = sigmoid(s D/tr) sigmoid(-s D/tr), and zero beyond the first zero crossing + tr, so that no surface shines through another. With
    s = 1 free space (D = tr) has a weight of 0.197 against the surface's 0.25. The published code of [25] divides by tr twice, which means
    s = 1/tr: 20 there, and 10 for tr = 0.1 m. With an exact T-SDF, 128 + 16 samples up to 5 m and tr = 0.1 m, the error of depth
    (mean, RMS) is -103, 115 cm at s = 1, -24, 30 cm at 5, -0.15, 0.35 cm at 10 and 0.00, 0.20 cm at 20.
    """
    bell = torch.sigmoid(sharpness * sdf) * torch.sigmoid(-sharpness * sdf)
    limit = zero_crossing(sdf.detach(), depths.detach()) + truncation
    bell = bell * (depths.detach() <= limit[:, None])
    return bell / (bell.sum(1, keepdim=True) + 1e-8)


def query(field: FieldFunction, origins: Tensor, directions: Tensor, depths: Tensor) -> tuple[Tensor, Tensor]:
    """The field at `depths` (B, S) along rays (B, 3): T-SDF (B, S) [tr] and colour (B, S, 3)."""
    points = origins[:, None] + directions[:, None] * depths[..., None]
    views = F.normalize(directions, dim=-1)[:, None].expand_as(points)
    sdf, colour = field(points.reshape(-1, 3), views.reshape(-1, 3))
    return sdf.view(depths.shape), colour.view(*depths.shape, 3)


def render(
    field: FieldFunction, origins: Tensor, directions: Tensor, far: Tensor, march: RayMarch, *, generator: torch.Generator | None = None
) -> Rendered:
    """Colour and depth of rays (B, 3), (B, 3) up to depth `far` (B,) [m]: the means of their samples' values, weighted by `render_weights`.

    The stratified samples are evaluated first, and importance samples are drawn from their weights. Both are rendered together. Without a
    generator the samples are placed evenly, so that an image is repeatable.
    """
    depths = stratified_depths(march.near, far, march.samples, generator)
    sdf, colour = query(field, origins, directions, depths)
    if march.importance_samples:
        coarse = render_weights(sdf.detach(), depths, march.truncation, march.sharpness)
        finer = importance_depths(depths, coarse, march.importance_samples, generator)
        finer_sdf, finer_colour = query(field, origins, directions, finer)
        depths, order = torch.cat([depths, finer], 1).sort(1)
        sdf = torch.cat([sdf, finer_sdf], 1).gather(1, order)
        colour = torch.cat([colour, finer_colour], 1).gather(1, order[..., None].expand(-1, -1, 3))
    weights = render_weights(sdf, depths, march.truncation, march.sharpness)
    return Rendered((weights[..., None] * colour).sum(1), (weights * depths).sum(1), sdf, depths, weights)
