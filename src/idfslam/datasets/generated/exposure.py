"""Automatic exposure: a slow loop that sets exposure time and gain so that views become equally bright, with a lag."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

_TARGET = 0.42  # [1] brightness, as the mean logarithm, at which an image is exposed as in the ideal twin; raised, images are brighter.
#    The median over generated rooms
_USUAL = 0.009, 0.014  # [s] exposure time at that brightness; raised, images are more blurred. This and the rest: chosen by hand
_SHORTEST, _LONGEST = 0.004, 0.015  # [s] limits of the exposure time; above the second the gain rises; raised, images are more blurred
_HIGHEST = 8.0  # [1] largest gain; raised, darker views become as bright as others
_LAG = 0.4  # [s] in which the loop makes up for two thirds of a change; raised, brightness changes more from frame to frame
_MEMORY = 45  # images that the loop remembers; raised, older ones count, with less than 3 % of the weight


@dataclass(frozen=True)
class Exposure:
    """The exposure of one image."""

    time: float  # [s]
    gain: float  # [1] of the sensor's signal
    brightness: float  # [1] of the image against the one of the ideal twin: the product of time and gain, and of a constant


class AutomaticExposure:
    """The exposure of each image of a recording, which depends on the brightness of the images before it.

    `brightness` gives the brightness of the view of an image by its number. At strength 2 a view of half the target's brightness
    gets four times the light instead of twice, and every exposure takes twice as long.
    """

    def __init__(self, brightness: Callable[[int], float], fps: float, seed: int, strength: float) -> None:
        self._usual, self._strength = float(np.random.default_rng([seed, 71]).uniform(*_USUAL)), strength
        self._correction = lru_cache(maxsize=4 * _MEMORY)(lambda shot: np.log(_TARGET / brightness(shot)))
        weights = np.exp(-np.arange(_MEMORY) / (_LAG * fps))
        self._weights = weights / weights.sum()

    def of(self, shot: int) -> Exposure:
        """The exposure of image number `shot` >= 0. The camera looked at the first view long enough before."""
        seen = [self._correction(max(shot - 1 - k, 0)) for k in range(_MEMORY)]
        wanted = float(np.exp(self._strength * (self._weights @ seen)))
        time = float(np.clip(wanted * self._usual, _SHORTEST, _LONGEST))
        gain = float(np.clip(wanted * self._usual / time, 1, _HIGHEST))
        return Exposure(time * self._strength, gain, time * gain / self._usual)
