"""A frame's image at 60 and 30 rows, where noise, blur and fine texture are gone, and its pixels as points to compare others with."""

import torch
import torch.nn.functional as F

from idfslam.alignment.displacement import level_of
from idfslam.alignment.image_pyramid import Level
from idfslam.alignment.landmarks import Landmarks, pixels_in_depth
from idfslam.alignment.sighting import Appearance

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
    row, column = pixels_in_depth(coarse, depth)
    z, uv = depth[row[:, None], column[None]], coarse.camera.pixels(depth.device)
    points = (coarse.camera.rays(uv) * torch.where(z > 0, z, _FAR)[..., None]).reshape(-1, 3)
    ratio = uv.new_tensor([fine.camera.width / coarse.camera.width, fine.camera.height / coarse.camera.height])
    in_fine = ((uv + 0.5) * ratio - 0.5).reshape(-1, 2)
    brightness = [fine.luminance_at(in_fine).contiguous(), coarse.luminance.flatten()]
    if not with_depth:
        return Landmarks(points, brightness, [])
    known = (z > 0).flatten()
    return Landmarks(points[known], [level[known].contiguous() for level in brightness], [])
