"""A walk round the corridor with a hand-held camera: laps of one path, no two of them alike.

The path is the middle line with rounded corners. Speed, sway and gaze vary with time in periods that do not fit into a lap;
where the person looks into a door or a room is drawn anew for every lap. Pose i depends on seed and plan alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from idfslam.datasets.generated.rendered import FPS, looking
from idfslam.scenes.corridor import Plan

Array = NDArray[np.float64]

OVERLAP = 2.5  # [m] walked past the end of the last lap
_STEP = 0.01  # [m] between points of the path
_RADIUS = 0.75  # [m] of corners
_SPEED = 0.67  # [m/s] along straight stretches
_EASE = 0.08  # share of the speed that is lost in corners
_EYE = 1.45  # [m] height of the camera
_GLANCE = 1.7  # [s] half of the time that a look to the side takes


@dataclass(frozen=True)
class Path:
    """One lap, by the distance walked [m]."""

    length: float
    """[m]."""
    distance: Array
    """(N + 1,) of the points, from 0 to `length` [m]."""
    points: Array
    """(N + 1, 2) [m]; the last is the first."""
    lean: Array
    """(N + 1,) heading less what an even turn over the whole lap would give [rad]; the last is the first."""
    time: Array
    """(N + 1,) when a walker of even pace is there [s]."""


def closed_path(half: tuple[float, float]) -> Path:
    """The rectangle of half-lengths `half` [m] with round corners, anticlockwise, from the middle of the side at y = -half_y."""
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
    """How many frames a walk of so many laps and the overlap takes, at an even pace."""
    path = closed_path(half)
    return int(np.ceil((laps * path.time[-1] + np.interp(OVERLAP, path.distance, path.time)) * FPS)) + 1


def walk(seed: int, frames: int, plan: Plan) -> Array:
    """(N, 4, 4) camera-to-world poses."""
    path, rng = closed_path(plan.half), np.random.default_rng([seed, 19])
    t = np.arange(frames) / FPS
    hurry = _wander(t, rng, 0.12, (9.1, 5.3))
    pace = t + hurry - hurry[0]
    s = np.interp(pace % path.time[-1], path.time, path.distance)
    points = CubicSpline(path.distance, path.points, bc_type="periodic")
    lean = CubicSpline(path.distance, path.lean, bc_type="periodic")

    def direction(s: Array) -> Array:
        return np.asarray(lean(s % path.length)) + 2 * np.pi * s / path.length

    flat, ahead = direction(s), direction(s + 0.35)  # the eyes turn before the feet
    aside = _wander(t, rng, 0.1, (8.3, 13.7)) + _wander(t, rng, 0.006, (1.13, 0.61))
    position = np.zeros((frames, 3))
    position[:, :2] = points(s) + aside[:, None] * np.stack([-np.sin(flat), np.cos(flat)], 1)
    position[:, 2] = _EYE + _wander(t, rng, 0.05, (11.3, 6.1)) + _wander(t, rng, 0.01, (0.57, 1.31))
    shake = [_wander(t, rng, np.deg2rad(0.45), (2.9, 1.3, 0.63)) for _ in range(3)]
    yaw = ahead + _wander(t, rng, np.deg2rad(12), (9.7, 6.7, 4.3)) + shake[0]
    yaw += _glances(seed, plan, path, pace)
    pitch = np.deg2rad(-9) + _wander(t, rng, np.deg2rad(7), (7.9, 5.1)) + shake[1]
    return looking(position, yaw, pitch, _wander(t, rng, np.deg2rad(1.2), (6.3, 3.7)) + shake[2])


def _wander(t: Array, rng: np.random.Generator, size: float, periods: tuple[float, ...]) -> Array:
    """(N,) a sum of sines of the periods [s], at most `size` times the square root of their number."""
    phases = rng.uniform(0, 2 * np.pi, len(periods))
    return size / np.sqrt(len(periods)) * np.sin(2 * np.pi * t[:, None] / np.array(periods) + phases).sum(1)


def _glances(seed: int, plan: Plan, path: Path, pace: Array) -> Array:
    """(N,) the turn of the head [rad] towards openings, and towards some doors, of each lap, at the times `pace` of an even walk."""
    turn = np.zeros(len(pace))
    heading = path.lean + 2 * np.pi * path.distance / path.length
    bend = np.gradient(heading, path.distance)
    straight = maximum_filter1d(bend, round(1.8 / _STEP), mode="wrap") < 0.5 * bend.max()
    places = np.array([T[:2, 3] for T in plan.openings + plan.doors])
    for lap in range(int(pace.max() // path.time[-1]) + 1):
        rng, taken = np.random.default_rng([seed, 23, lap]), list[float]()
        for k in [*range(len(plan.openings)), *(rng.permutation(len(plan.doors)) + len(plan.openings))]:
            nearest = int(np.linalg.norm(path.points - places[k], axis=1).argmin())
            start = nearest - round(0.5 / _STEP)  # where the place lies half ahead, half beside
            amount, wanted = np.deg2rad(rng.uniform(48, 62)), rng.random() < (0.85 if k < len(plan.openings) else 0.3)
            when = lap * path.time[-1] + path.time[start]
            if not wanted or start < 0 or not straight[start] or any(abs(when - other) < 2 * _GLANCE for other in taken):
                continue
            taken.append(when)
            (x, y), phi = places[k] - path.points[nearest], heading[nearest]
            side = np.sign(np.cos(phi) * y - np.sin(phi) * x)
            turn += side * amount * np.cos(np.pi / 2 * np.clip((pace - when) / _GLANCE, -1, 1)) ** 2
    return turn
