"""When frames are taken: depth by a clock of its own, whose stamps lie by a constant; and which frames are missing."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.generated.rendered import FPS

Shots = NDArray[np.int64]

_SWEEP = 150, 350  # frames in which the stamps of depth drift by one whole frame; raised, they drift more slowly. Chosen by hand
_DELAY = 0.005, 0.012  # [s] by which the stamps of depth lie, to either side; raised, depth is farther from where it says. Chosen by hand
_GAP = 40  # frames between two gaps in the mean; raised, fewer frames are missing. This and the next two: chosen by hand
_FIRST_GAP = 10  # frames that are never missing at the beginning; raised, later frames are missing
_SINGLE = 0.6  # [1] share of gaps of a single frame, the others have 2 to 4; raised, gaps are shorter


@dataclass(frozen=True)
class DepthClock:
    """The clock of the depth camera: its frames are a little closer than those of colour, and each colour image gets the nearest one."""

    sweep: float  # frames of colour in which depth gains one frame
    phase: float  # [1] of a frame, of the first depth image
    strength: float  # [1] 1: stamps differ by up to half a frame; 0: they are equal
    delay: float  # [s] by which depth is taken later than its stamps say

    @staticmethod
    def drawn(seed: int, strength: float) -> "DepthClock":
        """The clock of a recording with this seed."""
        rng = np.random.default_rng([seed, 59])
        sweep, phase = rng.uniform(*_SWEEP), rng.uniform(-0.5, 0.5)
        return DepthClock(sweep, phase, strength, float(rng.uniform(*_DELAY) * rng.choice([-1, 1]) * strength))

    def stamps(self, shots: Shots) -> NDArray[np.float64]:
        """(N,) [s] the stamps of depth that belong to these colour images (N,)."""
        step = 1 - 1 / self.sweep
        nearest = self.phase + np.round((shots - self.phase) / step) * step
        return np.asarray((shots + self.strength * (nearest - shots)) / FPS)


def kept_shots(seed: int, strength: float, frames: int) -> Shots:
    """(N,) the numbers of the first `frames` images that are not missing, of all that the camera took."""
    if strength == 0:
        return np.arange(frames)
    rng, kept, shot = np.random.default_rng([seed, 61]), [np.arange(_FIRST_GAP)], _FIRST_GAP
    count = _FIRST_GAP
    while count < frames:
        length = int(rng.geometric(min(strength / _GAP, 0.5)))
        kept.append(np.arange(shot, shot + length))
        shot, count = shot + length + (1 if rng.random() < _SINGLE else int(rng.integers(2, 5))), count + length
    return np.concatenate(kept)[:frames]
