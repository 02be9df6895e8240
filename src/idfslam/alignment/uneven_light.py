"""Light that changes unevenly: a shadow falls, a blind opens, the camera carries a torch.

Each part of the image has a gain of its own, relative to the image's, bilinear between the centres of the parts. At a wrong pose brightness
differs too, and what a displacement of a part explains must not pass for light. So a part's gain is estimated together with its
displacement (`parts_of_light.py`), and only the gain is taken out. Light that flickers in bands of rows, finer than the parts, is taken out
before (`flicker.py`).
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from idfslam.alignment.constants import LIGHT_COLUMNS, LIGHT_ROWS, UNCHANGED
from idfslam.alignment.exposure import exposure
from idfslam.alignment.flicker import plain_flicker
from idfslam.alignment.parts_of_light import changes, weights


@dataclass(frozen=True)
class Relit:
    """How the brightness of landmarks differs from that in the keyframe after light is taken out."""

    difference: Tensor  # (M,) [1]
    gain: Tensor  # (M,) [1] of the contrast, by exposure and light


def plain_relit(target: Tensor, value: Tensor, slope_u: Tensor, slope_v: Tensor, place: Tensor) -> Relit:
    """Takes light out of the brightness of M landmarks, in torch, on any device; `kernels/light.py` has the compiled form.

    target, value (M,): brightness in the keyframe and in the frame; slope_u, slope_v (M,): its slopes [1/px]; place (M, 3): column and row
    in the image, and row in the keyframe's, each from 0 to 1. The light is estimated twice: then exposure is known without it, and
    landmarks have robust weights.
    """
    if not len(target):
        return Relit(torch.zeros_like(value), torch.ones_like(value))
    flicker = plain_flicker(target, value, slope_u, slope_v, place[:, 1:])
    value, slope_u, slope_v = value / flicker, slope_u / flicker, slope_v / flicker
    size, in_image = place.new_tensor([LIGHT_COLUMNS, LIGHT_ROWS]), place[:, :2]
    column, row = torch.minimum((in_image * size).long(), size.long() - 1).unbind(-1)
    part, light, weight = row * LIGHT_COLUMNS + column, torch.ones_like(value), torch.ones_like(value)
    parts = LIGHT_ROWS * LIGHT_COLUMNS
    for _ in range(2):
        gain, offset = exposure(target, value / light, torch.ones_like(value))
        expected = gain * target + offset
        columns = torch.stack([expected, slope_u, slope_v], -1)
        change = changes(part, columns, value - expected, weight, parts, UNCHANGED)
        weight = weights(part, value - expected - (columns * change[part]).sum(-1), parts)
        light = _light_at(change[:, 0], in_image)
    return Relit((value - expected * light) * flicker, gain * light * flicker)


def _light_at(change: Tensor, place: Tensor) -> Tensor:
    """Light (M,) at places (M, 2), bilinear between the centres of the parts (parts,)."""
    image = change.reshape(1, 1, LIGHT_ROWS, LIGHT_COLUMNS)
    return 1 + F.grid_sample(image, (2 * place - 1)[None, None], padding_mode="border", align_corners=False)[0, 0, 0]
