"""A frame's image at 60 and 30 rows, where noise, blur and fine texture are gone, and its pixels as points to compare others with."""

from functools import lru_cache

import torch
import torch.nn.functional as F
from torch import Tensor

from idfslam.alignment.displacement import level_of
from idfslam.alignment.image_pyramid import Level
from idfslam.alignment.landmarks import Landmarks, pixels_in_depth
from idfslam.alignment.sighting import Appearance
from idfslam.geometry.camera import Camera

_FAR = 10.0  # [m] Distance that is assumed of a pixel without depth. More: its parallax is neglected more. Chosen by hand


def small_image(frame: Appearance) -> Appearance:
    """The brightness of a frame at about 60 and 30 rows."""
    fine = frame.levels[level_of(frame)]
    smaller = F.avg_pool2d(fine.luminance[None], 2)[0]
    coarse = Level(smaller, fine.camera.resized(smaller.shape[1], smaller.shape[0]))
    return Appearance([fine, coarse], frame.depth, frame.camera)


def pixels_of(small: Appearance, *, with_depth: bool = False) -> Landmarks:
    """The points of all pixels of a small image's coarser level, with their brightness on both levels. with_depth: of those with depth."""
    (fine, coarse), depth = small.levels, small.depth
    rays, in_fine, in_depth = _grid(coarse.camera, fine.camera, depth.shape[0], depth.shape[1], depth.device)
    z = depth.flatten()[in_depth]
    points = rays * torch.where(z > 0, z, _FAR)[:, None]
    brightness = [fine.luminance_at(in_fine).contiguous(), coarse.luminance.flatten()]
    if not with_depth:
        return Landmarks(points, brightness, [])
    known = z > 0
    return Landmarks(points[known], [level[known].contiguous() for level in brightness], [])


@lru_cache(maxsize=8)
def _grid(coarse: Camera, fine: Camera, height: int, width: int, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """For all pixels of the coarser level: rays (N, 3), pixels of the finer one (N, 2), and places in a depth image, row by row (N,).

    They are the same for all frames of a camera.
    """
    uv = coarse.pixels(device)
    ratio = uv.new_tensor([fine.width / coarse.width, fine.height / coarse.height])
    row, column = pixels_in_depth(coarse, torch.empty(height, width, device=device))
    in_depth = (row[:, None] * width + column[None]).flatten()
    return coarse.rays(uv).reshape(-1, 3), ((uv + 0.5) * ratio - 0.5).reshape(-1, 2), in_depth
