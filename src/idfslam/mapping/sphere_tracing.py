"""Where rays meet the surface of a T-SDF: they advance by the distance that the field says is free (Hart 1996).

For images, cones around tiles of pixels are marched first, as far as they are free as a whole: most of a ray's way leads through
free space that its neighbours share. The pixels' own rays start where their cone ends.
"""

from collections.abc import Callable
from functools import partial
from typing import Protocol

import torch
from torch import Tensor

from idfslam.geometry.camera import Camera
from idfslam.mapping.rendering import RenderedImage, world_rays

LEAST_STEP = 0.1  # [tr] least step: close to a surface that a ray passes by, steps would otherwise vanish. More: thin surfaces are missed
CAUTION = 0.9  # [1] share of the free distance by which a ray advances, since the field is not exact. More: fewer steps, more overshoot
_TILE = 8  # [px] edge of the tile that one cone is traced for first; more: fewer cones, which end farther from the surface
_NEAR = 0.05  # [m] depth at which rays start; more: surfaces close to the camera are not seen
_LAYERS = 5  # unobserved surfaces that a ray passes through at most; more: fewer holes, more time

Sdf = Callable[[Tensor], Tensor]  # points (N, 3) [m] -> (N,) [tr]


class Trace(Protocol):
    """`trace` through some field."""

    def __call__(self, origins: Tensor, directions: Tensor, *, near: float | Tensor, far: float, truncation: float) -> Tensor: ...


@torch.no_grad()
def trace(sdf: Sdf, origins: Tensor, directions: Tensor, *, near: float | Tensor, far: float, truncation: float) -> Tensor:
    """Depths (B,) [m], in units of `directions` (B, 3), at which rays first pass from before the surface behind it; 0: nowhere.

    near: where the rays start, for all of them or each (B,). A ray that starts behind a surface has to come out in front first.
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
    """Depths (B,) [m] up to which cones are free as a whole: their radius is `spread` times the depth.

    A cone ends where less than its radius is free, which is before any of its rays meets a surface.
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
    """The surface as `camera` at T_wc (4, 4) sees it up to depth `far` [m]; black, and depth 0, where it sees none.

    colour: points (N, 3) [m], directions (N, 3) -> (N, 3). observed: points (N, 3) -> whether surface there is to be believed (N,);
    rays pass through what is not, since a field says anything where it was taught nothing. tracer: a faster `trace` through this field.
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
    """Moves depths (B,) on, in place, to the first surface that was observed; 0 where there is none."""
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
    """(H, W) [m] up to where nothing is in the way of each pixel, by the cone of its tile."""
    rows, columns = -(-camera.height // _TILE), -(-camera.width // _TILE)
    v, u = (_TILE * torch.arange(n, dtype=torch.float32, device=T_wc.device) + (_TILE - 1) / 2 for n in (rows, columns))
    centres = torch.stack([u.expand(rows, -1), v[:, None].expand(-1, columns)], -1).reshape(-1, 2)
    spread = _TILE / 2**0.5 / min(camera.fx, camera.fy)  # from a tile's centre to its corner
    free = march_cones(sdf, *world_rays(T_wc, camera, centres), spread, near=_NEAR, far=far, truncation=truncation)
    every = free.view(rows, columns).repeat_interleave(_TILE, 0).repeat_interleave(_TILE, 1)
    return every[: camera.height, : camera.width].contiguous()
