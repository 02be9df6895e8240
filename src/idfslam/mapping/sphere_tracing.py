"""Sphere tracing (Hart 1996): rays advance to the surface of a T-SDF in steps of the field's distance.

For images, cones around tiles of pixels are traced first, through the free space that neighbouring rays share. The pixels' own rays start
where their cone ends.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import torch
from torch import Tensor

from idfslam.geometry.camera import Camera
from idfslam.mapping.tsdf_rendering import world_rays

# All of these were chosen by hand.
LEAST_STEP = 0.1  # [tr] least step. Without it, steps vanish where a ray passes close to a surface. More: thin surfaces are missed
CAUTION = 0.9  # [1] share of the distance by which a ray advances, since the field is not exact. More: fewer steps, more overshoot
_TILE = 8  # [px] edge of the tile of pixels of one cone. More: fewer cones, which end farther from the surface
_NEAR = 0.05  # [m] depth at which rays start. More: surfaces close to the camera are not seen
_LAYERS = 5  # largest number of unobserved surfaces that a ray passes through. More: fewer holes, more time

Sdf = Callable[[Tensor], Tensor]  # points (N, 3) [m] -> (N,) [tr]


class Trace(Protocol):
    """`trace` through one field."""

    def __call__(self, origins: Tensor, directions: Tensor, *, near: float | Tensor, far: float, truncation: float) -> Tensor: ...


@dataclass(frozen=True)
class RenderedImage:
    """A rendered image of the map."""

    colour: Tensor  # (H, W, 3) in [0, 1]
    depth: Tensor  # (H, W) [m], 0 where the ray meets no surface


@torch.no_grad()
def trace(sdf: Sdf, origins: Tensor, directions: Tensor, *, near: float | Tensor, far: float, truncation: float) -> Tensor:
    """Depths (B,) [m] at which rays first pass from the front of a surface to its back; 0 for rays that meet none.

    Depth is in units of `directions` (B, 3). near: depth at which the rays start, one for all or one for each (B,). A ray that starts
    behind a surface must come out in front first.
    """
    depth = origins.new_zeros(len(origins))
    ray = torch.arange(len(origins), device=origins.device)
    t = torch.as_tensor(near, dtype=origins.dtype, device=origins.device).expand(len(origins))
    t_before, before = t, torch.full_like(t, -1)  # where the rays were one step earlier, and the T-SDF there
    reach = truncation / directions.norm(dim=-1)  # of tr, in depth along each ray
    while len(ray):
        here = sdf(origins[ray] + directions[ray] * t[:, None])
        hit = (before > 0) & (here <= 0)
        share = before / (before - here).where(hit, torch.ones_like(here))
        depth[ray[hit]] = (t_before + (t - t_before) * share)[hit]
        following = t + CAUTION * here.abs().clamp(LEAST_STEP, 1) * reach[ray]
        on = ~hit & (following < far)
        ray, t_before, before, t = ray[on], t[on], here[on], following[on]
    return depth


@torch.no_grad()
def march_cones(sdf: Sdf, origins: Tensor, directions: Tensor, spread: float, *, near: float, far: float, truncation: float) -> Tensor:
    """Depths (B,) [m] up to which cones pass through free space. A cone's radius is `spread` times the depth.

    A cone ends where the distance is less than its radius, so before any of its rays meets a surface.
    """
    reached = origins.new_full((len(origins),), near)
    ray, t = torch.arange(len(origins), device=origins.device), reached.clone()
    reach = truncation / directions.norm(dim=-1)
    while len(ray):
        free = sdf(origins[ray] + directions[ray] * t[:, None]) - spread * t / truncation  # [tr]
        on = free > LEAST_STEP
        ray, t, free = ray[on], t[on], free[on]
        reached[ray] = t
        t = t + CAUTION * free.clamp(max=1) * reach[ray]
        on = t < far
        ray, t = ray[on], t[on]
    return reached


@torch.no_grad()
def trace_image(
    sdf: Sdf,
    colour: Callable[[Tensor, Tensor], Tensor],
    T_wc: Tensor,
    camera: Camera,
    *,
    far: float,
    truncation: float,
    observed: Callable[[Tensor], Tensor] | None = None,
    tracer: Trace | None = None,
    rays_a_chunk: int = 1 << 16,
) -> RenderedImage:
    """The surface that `camera` at T_wc (4, 4) sees up to depth `far` [m]; black, and depth 0, where it sees none.

    colour: points (N, 3) [m], directions (N, 3) -> (N, 3). observed: points (N, 3) -> whether the surface there was observed (N,). Rays
    pass through unobserved surface, since a field is arbitrary where it has not learnt. tracer: a faster `trace` through this field.
    """
    tracer = tracer or partial(trace, sdf)
    near = _free_depths(sdf, T_wc, camera, far, truncation).flatten().split(rays_a_chunk)
    colours, depths = [], []
    for uv, start in zip(camera.pixels(T_wc.device).view(-1, 2).split(rays_a_chunk), near):
        origins, directions = world_rays(T_wc, camera, uv)
        depth = tracer(origins, directions, near=start, far=far, truncation=truncation)
        if observed is not None:
            _pass_through(tracer, observed, origins, directions, depth, far, truncation)
        met = depth > 0
        seen = torch.zeros_like(origins)
        seen[met] = colour((origins + directions * depth[:, None])[met], directions[met])
        colours.append(seen)
        depths.append(depth)
    shape = (camera.height, camera.width)
    return RenderedImage(torch.cat(colours).view(*shape, 3), torch.cat(depths).view(shape))


def _pass_through(
    tracer: Trace, observed: Callable[[Tensor], Tensor], origins: Tensor, directions: Tensor, depth: Tensor, far: float, truncation: float
) -> None:
    """Moves depths (B,), in place, to the first observed surface; 0 where there is none."""
    ray = torch.nonzero(depth > 0)[:, 0]
    for _ in range(_LAYERS):
        ray = ray[~observed(origins[ray] + directions[ray] * depth[ray, None])]
        if not len(ray):
            return
        near = depth[ray] + LEAST_STEP * truncation
        depth[ray] = tracer(origins[ray], directions[ray], near=near, far=far, truncation=truncation)
        ray = ray[depth[ray] > 0]
    depth[ray] = 0


def _free_depths(sdf: Sdf, T_wc: Tensor, camera: Camera, far: float, truncation: float) -> Tensor:
    """Depths (H, W) [m] up to which the ray of each pixel is in free space, from the cone of its tile."""
    rows, columns = -(-camera.height // _TILE), -(-camera.width // _TILE)
    v, u = (_TILE * torch.arange(n, dtype=torch.float32, device=T_wc.device) + (_TILE - 1) / 2 for n in (rows, columns))
    centres = torch.stack([u.expand(rows, -1), v[:, None].expand(-1, columns)], -1).reshape(-1, 2)
    spread = _TILE / 2**0.5 / min(camera.fx, camera.fy)  # from a tile's centre to its corner
    free = march_cones(sdf, *world_rays(T_wc, camera, centres), spread, near=_NEAR, far=far, truncation=truncation)
    every = free.view(rows, columns).repeat_interleave(_TILE, 0).repeat_interleave(_TILE, 1)
    return every[: camera.height, : camera.width].contiguous()
