"""Light that flickers: a lamp on the mains under a rolling shutter brightens and darkens bands of rows.

Each band of rows of an image has a gain of its own. A keyframe's image has bands of its own too, elsewhere, so both are estimated from the
landmarks that a frame shows, one after the other. As in `uneven_light`, a gain is estimated together with the displacement of its band, so
that what a wrong pose does to an image does not pass for light. The gains count only where they explain clearly more than chance would, by
an F statistic: noise and wrong poses of an evenly lit image stay as they are.
"""

import math

import torch
from torch import Tensor

from idfslam.alignment.constants import BANDS, LEAST_EVIDENCE, UNLIT
from idfslam.alignment.exposure import exposure
from idfslam.alignment.parts_of_light import changes, weights


def plain_flicker(target: Tensor, value: Tensor, slope_u: Tensor, slope_v: Tensor, rows: Tensor) -> Tensor:
    """The light (M,) [1] of the rows that show M landmarks, in torch, on any device; `kernels/light.py` has the compiled form.

    rows (M, 2): of the frame and of the keyframe, from 0 to 1. All else is as for `uneven_light.plain_relit`. It is 1 where no light
    flickers.
    """
    gain, offset = exposure(target, value, torch.ones_like(value))
    expected = gain * target + offset
    of_frame = _of_bands(rows[:, 0], expected, value, slope_u, slope_v)
    if of_frame is None:
        return torch.ones_like(value)
    of_keyframe = _of_bands(rows[:, 1], expected, value / of_frame, slope_u / of_frame, slope_v / of_frame)
    return of_frame if of_keyframe is None else of_frame * of_keyframe


def _of_bands(row: Tensor, expected: Tensor, value: Tensor, slope_u: Tensor, slope_v: Tensor) -> Tensor | None:
    """The light (M,) of landmarks in these rows (M,), linear between the middles of the bands; None: nothing flickers."""
    band, columns = (row * BANDS).long().clamp(0, BANDS - 1), torch.stack([expected, slope_u, slope_v], -1)
    difference, weight, share = value - expected, torch.ones_like(value), 0.0
    for _ in range(2):
        change = changes(band, columns, difference, weight, BANDS, UNLIT)
        left = difference - (columns * change[band]).sum(-1)
        shared = change[band, 0].mean()  # what all bands share tells of no flicker: the image is black, or its exposure is off
        share = _share_beyond_chance(expected * (change[band, 0] - shared), left)
        if share == 0.0:
            return None
        weight = weights(band, left, BANDS)
    at = (row * BANDS - 0.5).clamp(0, BANDS - 1)
    upper = at.long().clamp(max=BANDS - 2)
    gains = change[:, 0]
    return 1 + share * torch.lerp(gains[upper], gains[upper + 1], at - upper)


def _share_beyond_chance(explained: Tensor, left: Tensor) -> float:
    """The share (0 to 1) of gains that is no chance, from the differences that they explain and those that are left, (M,) each.

    The noise is that of a normal distribution with this mean of absolute values, which outliers draw less than its squares.
    """
    noise = float(left.abs().mean()) ** 2 * math.pi / 2
    return min(max(float((explained**2).sum()) / max(LEAST_EVIDENCE * BANDS * noise, 1e-12) - 1, 0.0), 1.0)
