"""Light that changes unevenly: a shadow falls, a blind opens, the camera carries a torch.

Each part of the image has a gain of its own, relative to the image's, bilinear between the centres of the parts. At a wrong pose brightness
differs too, and what a displacement of a part explains must not pass for light. So a part's gain is estimated together with its
displacement (generalised optical flow: Negahdaripour, "Revised definition of optical flow: integration of radiometric and geometric cues
for dynamic scene analysis", 1998), and only the gain is taken out. Where a few landmarks, or those on one edge, tell both, the
displacement explains their differences and the gain stays that of the image. Nor does a gain change by more than light alone would explain.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from idfslam.alignment.constants import (
    LARGEST_CHANGE,
    LEAST_CHANGE,
    LEAST_DIFFERENCE,
    LIGHT_COLUMNS,
    LIGHT_ROWS,
    OUTLYING,
    UNCHANGED,
    UNMOVED,
)
from idfslam.alignment.exposure import exposure


@dataclass(frozen=True)
class Relit:
    """How the brightness of landmarks differs from that in the keyframe after light is taken out."""

    difference: Tensor  # (M,) [1]
    gain: Tensor  # (M,) [1] of the contrast, by exposure and light


def plain_relit(target: Tensor, value: Tensor, slope_u: Tensor, slope_v: Tensor, place: Tensor) -> Relit:
    """Takes light out of the brightness of M landmarks, in torch, on any device; `kernels/light.py` has the compiled form.

    target, value (M,): brightness in the keyframe and in the frame; slope_u, slope_v (M,): its slopes [1/px]; place (M, 2): in the
    image, each coordinate from 0 to 1. The light is estimated twice: then exposure is known without it, and landmarks have robust weights.
    """
    if not len(target):
        return Relit(torch.zeros_like(value), torch.ones_like(value))
    size = place.new_tensor([LIGHT_COLUMNS, LIGHT_ROWS])
    column, row = torch.minimum((place * size).long(), size.long() - 1).unbind(-1)
    part, light, weight = row * LIGHT_COLUMNS + column, torch.ones_like(value), torch.ones_like(value)
    for _ in range(2):
        gain, offset = exposure(target, value / light, torch.ones_like(value))
        expected = gain * target + offset
        columns = torch.stack([expected, slope_u, slope_v], -1)
        change = _changes(part, columns, value - expected, weight)
        weight = _weights(part, value - expected - (columns * change[part]).sum(-1))
        light = _light_at(change[:, 0], place)
    return Relit(value - expected * light, gain * light)


def _changes(part: Tensor, columns: Tensor, difference: Tensor, weight: Tensor) -> Tensor:
    """(parts, 3) change of light [1] and displacement [px] of each part, from what landmarks expect of these, columns (M, 3)."""
    parts = LIGHT_ROWS * LIGHT_COLUMNS
    H = columns.new_zeros(parts, 3, 3).index_add_(0, part, weight[:, None, None] * columns[:, :, None] * columns[:, None])
    b = columns.new_zeros(parts, 3).index_add_(0, part, (weight * difference)[:, None] * columns)
    count = weight.new_zeros(parts).index_add_(0, part, weight).clamp(min=1e-9)
    of_light, displaced = UNCHANGED * H[:, 0, 0] / count, UNMOVED * (H[:, 1, 1] + H[:, 2, 2]) / count
    ridge = torch.diag_embed(torch.stack([of_light, displaced, displaced], -1) + 1e-9)
    H = H + ridge
    alone = (b[:, :1] / H[:, :1, 0]).clamp(LEAST_CHANGE - 1, LARGEST_CHANGE - 1)
    light = torch.linalg.solve(H, b)[:, :1].clamp(alone.clamp(max=0), alone.clamp(min=0))
    rest = b[:, 1:] - H[:, 1:, 0] * light
    return torch.cat([light, torch.linalg.solve(H[:, 1:, 1:], rest)], -1)


def _weights(part: Tensor, left: Tensor) -> Tensor:
    """(M,) robust weights by what the change of its part does not explain of a landmark's brightness, over the mean of the part."""
    parts = LIGHT_ROWS * LIGHT_COLUMNS
    total, count = (left.new_zeros(parts).index_add_(0, part, x) for x in (left.abs(), torch.ones_like(left)))
    return 1 / (1 + (left / (OUTLYING * total / count + LEAST_DIFFERENCE)[part]) ** 2) ** 2


def _light_at(change: Tensor, place: Tensor) -> Tensor:
    """Light (M,) at places (M, 2), bilinear between the centres of the parts (parts,)."""
    image = change.reshape(1, 1, LIGHT_ROWS, LIGHT_COLUMNS)
    return 1 + F.grid_sample(image, (2 * place - 1)[None, None], padding_mode="border", align_corners=False)[0, 0, 0]
