"""Where rays meet the surface of a T-SDF: they advance by the distance that the field says is free (Hart 1996)."""

from collections.abc import Callable

import torch
from torch import Tensor

from idfslam.geometry.camera import Camera
from idfslam.mapping.rendering import RenderedImage, world_rays

_LEAST_STEP = 0.1  # [tr]: close to a surface that a ray passes by, steps would otherwise vanish
_CAUTION = 0.9  # share of the free distance by which a ray advances: the field is a little wrong


@torch.no_grad()
def trace(sdf: Callable[[Tensor], Tensor], origins: Tensor, directions: Tensor, *, near: float, far: float, truncation: float) -> Tensor:
    """Depths (B,) [m], in units of `directions` (B, 3), at which rays first pass from before the surface behind it; 0: nowhere.

    sdf: points (N, 3) [m] -> (N,) [tr]. A ray that starts behind a surface has to come out in front first.
    """
    depth = origins.new_zeros(len(origins))
    ray, t = torch.arange(len(origins), device=origins.device), origins.new_full((len(origins),), near)
    t_before, before = t, torch.full_like(t, -1)  # where the rays were one step earlier, and the T-SDF there
    reach = truncation / directions.norm(dim=-1)  # of tr, in depth along each ray
    while len(ray):
        here = sdf(origins[ray] + directions[ray] * t[:, None])
        hit = (before > 0) & (here <= 0)
        share = before / (before - here).where(hit, torch.ones_like(here))
        depth[ray[hit]] = (t_before + (t - t_before) * share)[hit]
        following = t + _CAUTION * here.abs().clamp(_LEAST_STEP, 1) * reach[ray]
        on = ~hit & (following < far)
        ray, t_before, before, t = ray[on], t[on], here[on], following[on]
    return depth


@torch.no_grad()
def trace_image(
    sdf: Callable[[Tensor], Tensor],
    colour: Callable[[Tensor, Tensor], Tensor],
    T_wc: Tensor,
    camera: Camera,
    *,
    far: float,
    truncation: float,
    rays_a_chunk: int = 1 << 16,
) -> RenderedImage:
    """The surface as `camera` at T_wc (4, 4) sees it up to depth `far` [m]; black, and depth 0, where it sees none.

    colour: points (N, 3) [m], directions (N, 3) -> (N, 3).
    """
    colours, depths = [], []
    for uv in camera.pixels(T_wc.device).view(-1, 2).split(rays_a_chunk):
        origins, directions = world_rays(T_wc, camera, uv)
        depth = trace(sdf, origins, directions, near=0.05, far=far, truncation=truncation)
        met = depth > 0
        seen = torch.zeros_like(origins)
        seen[met] = colour((origins + directions * depth[:, None])[met], directions[met])
        colours.append(seen)
        depths.append(depth)
    shape = (camera.height, camera.width)
    return RenderedImage(torch.cat(colours).view(*shape, 3), torch.cat(depths).view(shape))
