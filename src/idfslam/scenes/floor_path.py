"""A path on the floor, walked with pauses: from place to place at given times, away from the camera."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

Array = NDArray[np.float64]

_RATE = 60.0  # [Hz] at which a path is sampled; raised, it is finer. This and the rest: chosen by hand
_CLEARANCE = 0.95  # [m] least distance from the camera; raised, bodies fill less of the view
_ROUNDED = 0.15  # [s] over which corners are rounded; raised, turns are smoother
_STANDING = 0.08  # [m/s] below which a walker keeps its heading; raised, slow steps do not turn it


class FloorPath:
    """Position, heading and distance walked at any time from 0; after its last place nothing moves."""

    def __init__(self, times: Array, places: Array, camera: Callable[[Array], Array]) -> None:
        """times (N,) [s] from 0 on, places (N, 2) [m]; two equal places in a row are a pause. camera: times (M,) -> its places (M, 2)."""
        self._t = np.arange(0, times[-1], 1 / _RATE)
        places = np.asarray(PchipInterpolator(times, places)(self._t))
        places = gaussian_filter1d(_cleared(places, camera(self._t)), _ROUNDED * _RATE, axis=0, mode="nearest")
        velocity = np.gradient(places, 1 / _RATE, axis=0)
        self._places, self._speed = places, np.linalg.norm(velocity, axis=1)
        self._heading = gaussian_filter1d(_headings(velocity, self._speed), _ROUNDED * _RATE, mode="nearest")
        self._distance = np.concatenate([[0], np.cumsum(self._speed)[:-1] / _RATE])

    def place(self, seconds: float) -> tuple[float, float]:
        """[m] x and y."""
        return self._at(self._places[:, 0], seconds), self._at(self._places[:, 1], seconds)

    def heading(self, seconds: float) -> float:
        """[rad] about z, from x."""
        return self._at(self._heading, seconds)

    def distance(self, seconds: float) -> float:
        """[m] walked since time 0."""
        return self._at(self._distance, seconds)

    def speed(self, seconds: float) -> float:
        """[m/s]."""
        return self._at(self._speed, seconds)

    def _at(self, values: Array, seconds: float) -> float:
        return float(np.interp(seconds, self._t, values))


def _cleared(places: Array, camera: Array) -> Array:
    """Places (M, 2), moved away from the camera (M, 2) where they are too near."""
    away = places - camera
    distance = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
    return np.asarray(camera + away * np.maximum(_CLEARANCE / distance, 1))


def _headings(velocity: Array, speed: Array) -> Array:
    """(M,) [rad] of the motion; while it stands, a walker looks where it went or, at first, where it is going to go."""
    walks = speed > _STANDING
    if not walks.any():
        return np.zeros(len(speed))
    heading = np.unwrap(np.arctan2(velocity[walks, 1], velocity[walks, 0]))
    last = np.maximum(np.cumsum(walks) - 1, 0)
    return np.asarray(heading[last])
