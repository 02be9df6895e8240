"""White noise on acceleration: how pose and velocity, and what is known of them, pass from one frame to the next.

The noise is that of Barfoot, Tong and Särkkä, "Batch continuous-time trajectory estimation as exactly sparse Gaussian process regression"
(RSS 2014).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_POSE, _VELOCITY = np.arange(6), np.arange(6, 12)  # the places of both in vectors (12,): a fact, not a choice


@dataclass(frozen=True)
class Passage:
    """The way from one frame to the next, as it was expected."""

    elapsed: float  # [s]
    deviation: Array  # (2,) of the next pose from constant velocity [m], [rad]

    @property
    def transition(self) -> Array:
        """(12, 12) how pose and velocity pass to the next frame."""
        F = np.eye(12)
        F[_POSE, _VELOCITY] = self.elapsed
        return F

    @property
    def noise(self) -> Array:
        """(12, 12) the covariance that is added on the way."""
        density = np.repeat(3 * self.deviation**2 / self.elapsed**3, 3)  # [m^2/s^3], [rad^2/s^3]
        noise = np.zeros((12, 12))
        noise[_POSE, _POSE], noise[_VELOCITY, _VELOCITY] = density * (self.elapsed**3 / 3), density * self.elapsed
        noise[_POSE, _VELOCITY] = noise[_VELOCITY, _POSE] = density * (self.elapsed**2 / 2)
        return noise

    def predicted(self, covariance: Array) -> Array:
        """(12, 12) the covariance of the next frame's pose and velocity, by that (12, 12) of the frame before."""
        F = self.transition
        return np.asarray(F @ covariance @ F.T + self.noise)
