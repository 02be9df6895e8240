"""Landmarks of a keyframe: points with a strong image gradient, whose brightness other frames are compared with."""

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from idfslam.alignment.image_pyramid import Level, with_slopes
from idfslam.compute.backend import pick
from idfslam.geometry.camera import Camera
from idfslam.sensing.depth_edges import EDGE, EDGE_SHARE
from idfslam.sensing.image_noise import noise_of

# All of these were chosen by hand.
# [1] Mean brightness of a dark image, and share of the wanted number of landmarks that are few. In a dark image with few landmarks, weaker
# ones are taken as well. More: in brighter images, and in those with more. Blurred images have few, too, and weaker ones are no gain there:
# fr1/rpy (brightness 0.43 to 0.59) had 1.76 and 2.18 instead of 1.67 and 1.57 cm, without regard to brightness
_DARK, _FEW = 0.3, 0.25
# [1] Gradient [1/px] of these, over the noise of the image: the steepest of 64 pixels of noise has two. More: fewer landmarks in the dark
_ABOVE_NOISE = 3.0
_WEAKEST = 0.2  # [1] least gradient of these, over that of others. More: fewer landmarks in dark images without noise


@dataclass(frozen=True)
class Landmarks:
    """Points of a keyframe with a strong image gradient, spread over the image."""

    points: Tensor  # (M, 3) [m] in the keyframe's frame
    luminance: list[Tensor]  # (M,) for each level of the pyramid
    slopes: list[Tensor]  # (2, M) derivatives of the luminance along u and v [1/px] for each level


def landmarks(levels: list[Level], depth: Tensor, *, count: int, least: float = 0.025) -> Landmarks:
    """About `count` landmarks: the pixel with the largest gradient in each cell of the finest level.

    A landmark has depth, no edge of the depth beside it, and a gradient above `least` [1/px]. In a dark image few are so steep. Then weaker
    ones that stand out from its noise are landmarks too.
    """
    fine = levels[0]
    measured = fine.camera.height * fine.camera.width * float((depth > 0).float().mean())
    cell = max(2, round((measured / count) ** 0.5))
    steepest = pick(depth, compiled=compiled_steepest, plain=plain_steepest)
    u, v = steepest(fine, depth, cell, least)
    if len(u) < _FEW * count and float(fine.luminance.mean()) < _DARK:
        u, v = steepest(fine, depth, cell, min(least, max(_ABOVE_NOISE * noise_of(fine.luminance), _WEAKEST * least)))
    row, column = pixels_in_depth(fine.camera, depth)
    points = fine.camera.rays(torch.stack([u, v], -1).to(depth.dtype)) * depth[row[v], column[u]][:, None]
    seen = [level.at(level.camera.project(points)[0]) for level in levels]
    return Landmarks(points, [values[0].contiguous() for values in seen], [values[1:].contiguous() for values in seen])


def plain_steepest(fine: Level, depth: Tensor, cell: int, least: float) -> tuple[Tensor, Tensor]:
    """u (M,) and v (M,) of the pixel with the largest gradient of each cell, in torch, on any device."""
    h, w = fine.camera.height // cell * cell, fine.camera.width // cell * cell
    slope = with_slopes(fine.luminance)[1:].norm(dim=0)
    row, column = pixels_in_depth(fine.camera, depth)
    z = depth[row[:, None], column[None]]
    nearest, farthest = -F.max_pool2d(-z[None], 3, 1, 1)[0], F.max_pool2d(z[None], 3, 1, 1)[0]
    slope = slope * ((nearest > 0) & (farthest - nearest < EDGE + EDGE_SHARE * nearest))
    cells = slope[:h, :w].reshape(h // cell, cell, w // cell, cell).transpose(1, 2).reshape(-1, cell * cell)
    best, place = cells.max(1)
    index = torch.nonzero(best > least).flatten()
    v = index // (w // cell) * cell + place[index] // cell
    u = index % (w // cell) * cell + place[index] % cell
    return u, v


def compiled_steepest(fine: Level, depth: Tensor, cell: int, least: float) -> tuple[Tensor, Tensor]:
    """`plain_steepest` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_images

    most = (fine.camera.height // cell) * (fine.camera.width // cell)
    u, v = torch.empty(most, dtype=torch.int64), torch.empty(most, dtype=torch.int64)
    count = numba_images.steepest(fine.luminance.numpy(), depth.numpy(), cell, np.float32(least), u.numpy(), v.numpy())  # type: ignore[call-arg]
    return u[:count], v[:count]


def pixels_in_depth(camera: Camera, depth: Tensor) -> tuple[Tensor, Tensor]:
    """The row of a depth image (H, W) in which each row of a level of this camera lies, and the column for each of its columns."""
    row = ((torch.arange(camera.height, device=depth.device) + 0.5) * depth.shape[0] / camera.height).long()
    column = ((torch.arange(camera.width, device=depth.device) + 0.5) * depth.shape[1] / camera.width).long()
    return row, column
