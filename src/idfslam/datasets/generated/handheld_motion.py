"""The motion of a camera in a shaking hand: a calm walk, a tremor, and bursts of fast shaking about all three axes.

It is a smooth curve in continuous time: a pose is defined at every time, so that each row of an image can have its own. The hand turns
the camera about a point behind it. Bursts come in rounds of 20 s; the strongest of a round turns the camera by 6 to 8 degrees a frame.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Walk = Callable[[Array], Array]  # times (N,) [s] -> camera-to-world poses (N, 4, 4)

ROUND = 20.0  # [s] from one set of bursts to the next; raised, bursts are rarer. This and the rest: chosen by hand after TUM's fr1/rpy
_BURSTS = 5  # in a round; raised, more of the time is shaken
_LENGTH = 2.0, 3.6  # [s] of a burst from rest to rest; raised, more of the time is shaken
_FREQUENCY = 2.0, 6.0  # [Hz] of shaking; raised, a turn of one speed is smaller
_STRONGEST = np.deg2rad(192), np.deg2rad(210)  # [rad/s] fastest turn of a round's strongest burst; raised, frames are farther apart
_OTHERS = np.deg2rad(65), np.deg2rad(165)  # [rad/s] fastest turn of the other bursts; raised, likewise
_ASIDE = 0.25, 0.5  # [1] share of that speed about a second axis; raised, shaking is rounder
_TREMOR = np.deg2rad(10)  # [rad/s] fastest turn of each of the sines that never rest; raised, the calm parts are less calm
_TREMORS = 1.1, 1.7, 2.6  # [Hz] of these sines; raised, a turn of one speed is smaller
_PIVOT = 0.2  # [m] from the camera back to the point about which the hand turns it; raised, shaking moves the camera more
_STEP = 1e-4  # [s] of the difference quotient of a velocity; raised, it is coarser; lowered, digits are lost


@dataclass(frozen=True)
class Burst:
    """Shaking that swells and fades away within `length`; about two axes (2, 3) in the camera's frame, at full strength at `middle`."""

    middle: float  # [s]
    length: float  # [s]
    axes: Array  # (2, 3) unit vectors, perpendicular
    speed: Array  # (2,) [rad/s] fastest turn
    frequency: Array  # (2,) [Hz]
    phase: Array  # (2,) [rad] 0: fastest in the middle

    def turn(self, t: Array) -> Array:
        """(N, 3) rotation vectors [rad] at times (N,) [s]."""
        since = (t - self.middle)[:, None]
        swell = np.cos(np.pi * np.clip(since / self.length, -0.5, 0.5)) ** 4
        angle = self.speed / (2 * np.pi * self.frequency) * np.sin(2 * np.pi * self.frequency * since + self.phase)
        return np.asarray((swell * angle) @ self.axes)


class HandheldMotion:
    """A calm walk, shaken: `pose_at(t)` for any times. The seed draws when, how strongly and about which axes the camera is shaken."""

    def __init__(self, walk: Walk, seed: int) -> None:
        self._walk = walk
        self._tremor_phases = np.random.default_rng([seed, 41]).uniform(0, 2 * np.pi, (len(_TREMORS), 3))
        self.bursts = cache(lambda number: _bursts(seed, number))
        """The bursts of round 0, 1, 2 ..."""

    def pose_at(self, t: Array) -> Array:
        """Camera-to-world poses (N, 4, 4) at times (N,) [s]."""
        shake = np.tile(np.eye(4), (len(t), 1, 1))
        shake[:, :3, :3] = R = Rotation.from_rotvec(self._turn(t)).as_matrix()
        shake[:, :3, 3] = np.array([0, 0, -_PIVOT]) + _PIVOT * R[:, :, 2]
        return np.asarray(self._walk(t) @ shake)

    def velocity_at(self, t: float) -> Array:
        """(6,) [m/s, rad/s] shift and turn in the camera's frame: `pose_at(t + dt) = pose_at(t) exp(dt velocity)` for small dt."""
        before, at, after = self.pose_at(np.array([t - _STEP, t, t + _STEP]))
        shift = at[:3, :3].T @ (after[:3, 3] - before[:3, 3])
        turn = Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).as_rotvec()
        return np.concatenate([shift, turn]) / (2 * _STEP)

    def _turn(self, t: Array) -> Array:
        """(N, 3) rotation vectors [rad] of the hand in the camera's frame."""
        frequency = np.array(_TREMORS)[:, None]
        turn = (_TREMOR / (2 * np.pi * frequency) * np.sin(2 * np.pi * frequency * t[:, None, None] + self._tremor_phases)).sum(1)
        for number in np.unique(np.floor(t[t >= 0] / ROUND).astype(int)):
            for burst in self.bursts(int(number)):
                turn = turn + burst.turn(t)
        return np.asarray(turn)


def _bursts(seed: int, number: int) -> list[Burst]:
    """The bursts of one round, each in a slot of its own."""
    rng, slot = np.random.default_rng([seed, 43, number]), ROUND / _BURSTS
    strongest, bursts = rng.integers(_BURSTS), []
    for k in range(_BURSTS):
        length = rng.uniform(*_LENGTH)
        middle = number * ROUND + (k + 1) * slot - rng.uniform(length / 2, slot - length / 2)
        axes = np.linalg.qr(rng.standard_normal((3, 2)))[0].T
        speed = rng.uniform(*(_STRONGEST if k == strongest else _OTHERS))
        speeds = np.array([speed, speed * rng.uniform(*_ASIDE)])
        bursts.append(Burst(middle, length, axes, speeds, rng.uniform(*_FREQUENCY, 2), np.array([0.0, rng.uniform(0, 2 * np.pi)])))
    return bursts
