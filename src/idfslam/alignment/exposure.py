"""Gain and offset between two images: exposure that differs, or light that changed everywhere alike."""

import torch
from torch import Tensor

from idfslam.alignment.constants import LARGEST_CHANGE, LARGEST_GAIN, LEAST_CHANGE, LEAST_GAIN, LEAST_MEAN, LEAST_SPREAD, SAME_EXPOSURE


def exposure(target: Tensor, value: Tensor, inside: Tensor) -> tuple[Tensor, Tensor]:
    """Gain and offset with value = gain * target + offset over the landmarks in view, from means and standard deviations.

    Blur takes contrast and leaves the mean. So the ratio of the contrasts is the gain only within a range, about that of the means where
    these say that the exposure has changed, or the light.
    """
    n = inside.sum().clamp(min=1)
    mean_t, mean_v = (target * inside).sum() / n, (value * inside).sum() / n
    spread_t = (((target - mean_t) ** 2 * inside).sum() / n).sqrt()
    spread_v = (((value - mean_v) ** 2 * inside).sum() / n).sqrt()
    of_means = mean_v.clamp(min=LEAST_MEAN) / mean_t.clamp(min=LEAST_MEAN)
    change = torch.ones_like(of_means).clamp(of_means / SAME_EXPOSURE, of_means * SAME_EXPOSURE).clamp(LEAST_CHANGE, LARGEST_CHANGE)
    gain = (spread_v / spread_t.clamp(min=LEAST_SPREAD)).clamp(LEAST_GAIN * change, LARGEST_GAIN * change)
    return gain, mean_v - gain * mean_t
