"""Rays in the world through pixels of posed views, with the measured depth and colour."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from idfslam.compute.backend import pick
from idfslam.geometry.camera import Camera
from idfslam.mapping.constants import GRAZING
from idfslam.sensing.depth_edges import EDGE, EDGE_SHARE


class PosedView(Protocol):
    """A view with a pose: depth and colour from one camera."""

    T_wk: Tensor  # (4, 4) float64

    @property
    def camera(self) -> Camera: ...

    @property
    def depth(self) -> Tensor: ...  # (H, W) [m]

    @property
    def colour(self) -> Tensor: ...  # (H, W, 3)


_REACH = 2  # [px] distance to the neighbours from which a normal is computed. More: smoother normals, missing nearer to edges. By hand


@dataclass(frozen=True)
class Rays:
    """B rays. Directions have z = 1 in the camera's frame, so the parameter along a ray is depth."""

    origins: Tensor  # (B, 3) [m] world
    directions: Tensor  # (B, 3) world
    depth: Tensor  # (B,) [m], 0 = no reading
    colour: Tensor  # (B, 3) in [0, 1]
    cos_incidence: Tensor  # (B,) |normal . direction|: distance to the surface per metre of depth; 1 without a normal

    def __len__(self) -> int:
        return len(self.depth)

    def every(self, step: int, first: int) -> "Rays":
        """Every `step`-th ray from `first` on."""
        return Rays(*(getattr(self, name)[first::step].contiguous() for name in Rays.__dataclass_fields__))

    def in_turns(self, steps: int) -> "Rays":
        """The rays in the order of the steps: those of the first step (`every`), then those of the second, and so on."""
        order = torch.arange(len(self), device=self.depth.device).view(-1, steps).T.flatten()
        return Rays(*(getattr(self, name)[order] for name in Rays.__dataclass_fields__))


def cast(view: PosedView, uv: Tensor, T_wc: Tensor | None = None) -> Rays:
    """Rays through integer pixels (B, 2) (u, v) of a view, at its own pose or at `T_wc` (4, 4); differentiable in `T_wc`."""
    if T_wc is not None:
        return plain_cast(view, uv, T_wc)
    return pick(uv, compiled=compiled_cast, plain=plain_cast)(view, uv)


def plain_cast(view: PosedView, uv: Tensor, T_wc: Tensor | None = None) -> Rays:
    """`cast` in torch, on any device."""
    T = (view.T_wk if T_wc is None else T_wc).to(view.depth)
    u, v = uv.unbind(-1)
    camera = view.camera
    directions = camera.rays(uv.to(view.depth.dtype)) @ T[:3, :3].mT
    origins = T[:3, 3].expand_as(directions)
    return Rays(origins, directions, view.depth[v, u], view.colour[v, u], cos_incidence(view.depth, uv, camera))


def compiled_cast(view: PosedView, uv: Tensor) -> Rays:
    """`cast` by Numba, on the CPU, at the view's own pose."""
    from idfslam.mapping.kernels import numba_rays

    T = view.T_wk.float()
    directions, colour, depth, slope = torch.empty(len(uv), 3), torch.empty(len(uv), 3), torch.empty(len(uv)), torch.empty(len(uv))
    camera = [np.float32(value) for value in (view.camera.fx, view.camera.fy, view.camera.cx, view.camera.cy)]
    images, outputs = (view.depth.numpy(), view.colour.numpy()), [t.numpy() for t in (directions, depth, colour, slope)]
    numba_rays.cast(uv.numpy(), *images, *camera, T[:3, :3].contiguous().numpy(), _REACH, *outputs)  # type: ignore[call-arg]
    return Rays(T[:3, 3].expand_as(directions), directions, depth, colour, slope)


def join(rays: list[Rays]) -> Rays:
    """Concatenates several bundles of rays."""
    columns = ([getattr(r, name) for r in rays] for name in Rays.__dataclass_fields__)
    return Rays(*(torch.cat(column) for column in columns))


def cos_incidence(depth: Tensor, uv: Tensor, camera: Camera, *, reach: int = _REACH) -> Tensor:
    """|n . d| (B,) of the unit normal n of the surface and the ray d (z = 1), which turns a difference of depth into a distance.

    The normal is computed from the neighbours `reach` pixels away. The value is 1 where they are missing or an edge lies between.
    """
    u, v = uv.unbind(-1)
    left, right = (u - reach).clamp(min=0), (u + reach).clamp(max=camera.width - 1)
    up, down = (v - reach).clamp(min=0), (v + reach).clamp(max=camera.height - 1)
    points = []
    for x, y in ((left, v), (right, v), (u, up), (u, down)):
        points.append(camera.rays(torch.stack([x, y], -1).to(depth.dtype)) * depth[y, x][:, None])
    here = depth[v, u]
    z = torch.stack([p[:, 2] for p in points], -1)
    smooth = ((z > 0) & ((z - here[:, None]).abs() < EDGE + EDGE_SHARE * here[:, None])).all(-1)
    normal = torch.linalg.cross(points[1] - points[0], points[3] - points[2])
    length = normal.norm(dim=-1)
    direction = camera.rays(uv.to(depth.dtype))
    dot = ((normal * direction).sum(-1) / length.clamp(min=1e-12)).abs()
    return torch.where(smooth & (length > 1e-12), dot.clamp(min=GRAZING), torch.ones_like(here))
