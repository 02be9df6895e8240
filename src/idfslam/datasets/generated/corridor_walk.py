"""A walk around the corridor with a hand-held camera: laps of one path, each a little different.

The path is the middle line with rounded corners. Speed, sway and gaze vary in periods that do not divide a lap. For every lap it is drawn
anew at which doors and rooms the person looks. Pose i depends only on seed and plan.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from idfslam.datasets.generated.rendered import FPS, poses_looking
from idfslam.scenes.corridor import FloorPlan

Array = NDArray[np.float64]

OVERLAP = 2.5  # [m] walked beyond the end of the last lap; raised, more frames show the beginning again. This and the rest: chosen by hand
_STEP = 0.01  # [m] between points of the path; raised, the path is coarser
_RADIUS = 0.75  # [m] of corners; raised, turns are slower
_SPEED = 0.67  # [m/s] along straight stretches; raised, frames are farther apart
_EASE = 0.08  # [1] share of the speed lost in corners; raised, the walk is slower there
_EYE = 1.45  # [m] height of the camera above the floor; raised, more of the ceiling is seen
_GLANCE = 1.7  # [s] half the duration of a look to the side; raised, the head turns more slowly


@dataclass(frozen=True)
class Path:
    """One lap, sampled along the distance walked."""

    length: float
    """[m]."""
    distance: Array
    """(N + 1,) distance walked at each point, from 0 to `length` [m]."""
    points: Array
    """(N + 1, 2) positions [m]; the last equals the first."""
    lean: Array
    """(N + 1,) heading minus that of an even turn over the whole lap [rad]; the last equals the first."""
    time: Array
    """(N + 1,) time at which a walker of even pace reaches each point [s]."""


def closed_path(half: tuple[float, float]) -> Path:
    """The rectangle of half-lengths `half` [m] with rounded corners, anticlockwise, from the middle of the side at y = -half_y."""
    a, b = half[0] - _RADIUS, half[1] - _RADIUS
    arc = np.linspace(0, np.pi / 2, 120)
    pieces = [np.array([[0.0, -half[1]]])]
    for k, (x, y) in enumerate([(a, -b), (a, b), (-a, b), (-a, -b)]):
        phi = arc + (k - 1) * np.pi / 2
        pieces.append(np.stack([x + _RADIUS * np.cos(phi), y + _RADIUS * np.sin(phi)], 1))
    corners = np.concatenate([*pieces, pieces[0]])
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    even = np.arange(round(along[-1] / _STEP)) * along[-1] / round(along[-1] / _STEP)
    points = np.stack([np.interp(even, along, corners[:, i]) for i in range(2)], 1)
    points = gaussian_filter1d(points, 0.2 / _STEP, axis=0, mode="wrap")
    points = np.concatenate([points, points[:1]])
    distance = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    tangent = np.roll(points[:-1], -1, 0) - np.roll(points[:-1], 1, 0)
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    trend = 2 * np.pi * distance / distance[-1]
    lean = gaussian_filter1d(heading - trend[:-1], 0.4 / _STEP, mode="wrap")
    lean = np.append(lean, lean[0])
    bend = np.gradient(lean + trend, distance)
    pace = _SPEED * (1 - _EASE * bend / bend.max())
    time = np.concatenate([[0], np.cumsum(np.diff(distance) * 2 / (pace[1:] + pace[:-1]))])
    return Path(float(distance[-1]), distance, points, lean, time)


def lap_frames(half: tuple[float, float], laps: int) -> int:
    """The number of frames of `laps` laps and the overlap, at an even pace."""
    path = closed_path(half)
    return int(np.ceil((laps * path.time[-1] + np.interp(OVERLAP, path.distance, path.time)) * FPS)) + 1


def walk(seed: int, frames: int, plan: FloorPlan) -> Array:
    """(N, 4, 4) camera-to-world poses of the walk."""
    return Walk(seed, plan).pose_at(np.arange(frames) / FPS)


class Walk:
    """The walk of a seed as a smooth curve in continuous time."""

    def __init__(self, seed: int, plan: FloorPlan) -> None:
        rng = np.random.default_rng([seed, 19])
        self._path = path = closed_path(plan.half)
        self._points = CubicSpline(path.distance, path.points, bc_type="periodic")
        self._lean = CubicSpline(path.distance, path.lean, bc_type="periodic")
        self._hurry = _Wander(rng, 0.12, (9.1, 5.3))
        self._aside = _Wander(rng, 0.1, (8.3, 13.7)), _Wander(rng, 0.006, (1.13, 0.61))
        self._height = _Wander(rng, 0.05, (11.3, 6.1)), _Wander(rng, 0.01, (0.57, 1.31))
        self._shake = [_Wander(rng, np.deg2rad(0.45), (2.9, 1.3, 0.63)) for _ in range(3)]
        self._yaw = _Wander(rng, np.deg2rad(12), (9.7, 6.7, 4.3))
        self._pitch = _Wander(rng, np.deg2rad(7), (7.9, 5.1))
        self._roll = _Wander(rng, np.deg2rad(1.2), (6.3, 3.7))
        self._glances = cache(lambda lap: _glances(seed, plan, path, lap))

    def pose_at(self, t: Array) -> Array:
        """(N, 4, 4) camera-to-world poses at times (N,) [s]."""
        path = self._path
        pace = t + self._hurry(t) - self._hurry(np.zeros(1))
        s = np.interp(pace % path.time[-1], path.time, path.distance)
        flat, ahead = self._direction(s), self._direction(s + 0.35)  # the gaze turns before the feet
        aside = self._aside[0](t) + self._aside[1](t)
        position = np.zeros((len(t), 3))
        position[:, :2] = self._points(s) + aside[:, None] * np.stack([-np.sin(flat), np.cos(flat)], 1)
        position[:, 2] = _EYE + self._height[0](t) + self._height[1](t)
        shake = [turn(t) for turn in self._shake]
        yaw = ahead + self._yaw(t) + shake[0]
        yaw += self._turn_of_the_head(pace)
        return poses_looking(position, yaw, np.deg2rad(-9) + self._pitch(t) + shake[1], self._roll(t) + shake[2])

    def _direction(self, s: Array) -> Array:
        """(N,) heading [rad] of the path at distances (N,) [m]."""
        return np.asarray(self._lean(s % self._path.length)) + 2 * np.pi * s / self._path.length

    def _turn_of_the_head(self, pace: Array) -> Array:
        """(N,) [rad] at the times `pace` (N,) [s] of an even walk."""
        turn = np.zeros(len(pace))
        for lap in range(int((pace.max() + _GLANCE) // self._path.time[-1]) + 1):
            for when, angle in self._glances(lap):
                turn += angle * np.cos(np.pi / 2 * np.clip((pace - when) / _GLANCE, -1, 1)) ** 2
        return turn


class _Wander:
    """A sum of sines with these periods [s] and random phases; at most `size` times the square root of their number."""

    def __init__(self, rng: np.random.Generator, size: float, periods: tuple[float, ...]) -> None:
        self._size, self._periods = size, np.array(periods)
        self._phases = rng.uniform(0, 2 * np.pi, len(periods))

    def __call__(self, t: Array) -> Array:
        """(N,) at times (N,) [s]."""
        return np.asarray(self._size / np.sqrt(len(self._periods)) * np.sin(2 * np.pi * t[:, None] / self._periods + self._phases).sum(1))


def _glances(seed: int, plan: FloorPlan, path: Path, lap: int) -> list[tuple[float, float]]:
    """Times [s] of an even walk and angles [rad] of the looks to the side in one lap: to most openings and to some doors."""
    heading = path.lean + 2 * np.pi * path.distance / path.length
    bend = np.gradient(heading, path.distance)
    straight = maximum_filter1d(bend, round(1.8 / _STEP), mode="wrap") < 0.5 * bend.max()
    targets = np.array([T[:2, 3] for T in plan.openings + plan.doors])
    rng, glances = np.random.default_rng([seed, 23, lap]), list[tuple[float, float]]()
    for k in [*range(len(plan.openings)), *(rng.permutation(len(plan.doors)) + len(plan.openings))]:
        nearest = int(np.linalg.norm(path.points - targets[k], axis=1).argmin())
        start = nearest - round(0.5 / _STEP)  # where the target lies half ahead, half to the side
        amount, looks = np.deg2rad(rng.uniform(48, 62)), rng.random() < (0.85 if k < len(plan.openings) else 0.3)
        when = lap * path.time[-1] + path.time[start]
        if not looks or start < 0 or not straight[start] or any(abs(when - other) < 2 * _GLANCE for other, _ in glances):
            continue
        (x, y), phi = targets[k] - path.points[nearest], heading[nearest]
        glances.append((float(when), float(np.sign(np.cos(phi) * y - np.sin(phi) * x) * amount)))
    return glances
