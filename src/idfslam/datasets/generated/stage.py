"""Where people and things may stand in a generated scene, as seen by a camera on its walk."""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.generated.corridor_walk import closed_path
from idfslam.scenes.corridor import Corridor
from idfslam.scenes.furniture import place
from idfslam.scenes.room import Room, wall_frame

Array = NDArray[np.float64]
Walk = Callable[[Array], Array]  # times (N,) [s] -> camera-to-world poses (N, 4, 4)

# Both were chosen by hand.
_FROM_WALL = 0.4  # [m] from walls to where figures walk; raised, they stay farther in
_FROM_SIDE = 0.45  # [m] from the walls of a corridor; raised, figures come nearer to the camera


class Stage(ABC):
    """Where things may stand, as seen by a camera on its walk."""

    def __init__(self, walk: Walk) -> None:
        self._walk = walk

    def camera(self, t: Array) -> Array:
        """(N, 2) [m] the camera's places on the floor at times (N,) [s]."""
        return self._walk(t)[:, :2, 3]

    def gaze(self, t: float) -> float:
        """[rad] the direction of the camera on the floor."""
        forward = self._walk(np.array([t]))[0, :2, 2]
        return float(np.arctan2(forward[1], forward[0]))

    @abstractmethod
    def ahead(self, t: float, distance: float, angle: float) -> Array:
        """(2,) [m] a free place that the camera sees at a time at this distance and angle [rad], if there is one."""

    @abstractmethod
    def wall(self, t: float) -> Array:
        """(4, 4) the frame of a place at a wall that the camera sees at a time: x along the wall, y into the room, z up."""


class RoomStage(Stage):
    """The free floor of a room."""

    def __init__(self, walk: Walk, room: Room) -> None:
        super().__init__(walk)
        self._half = np.array(room.half)

    def ahead(self, t: float, distance: float, angle: float) -> Array:
        phi, free = self.gaze(t) + angle, self._half - _FROM_WALL
        return np.clip(self.camera(np.array([t]))[0] + distance * np.array([np.cos(phi), np.sin(phi)]), -free, free)

    def wall(self, t: float) -> Array:
        eye, phi = self.camera(np.array([t]))[0], self.gaze(t)
        forward = np.array([np.cos(phi), np.sin(phi)])
        frames = [wall_frame(k, (float(self._half[0]), float(self._half[1]))) for k in range(4)]
        reach = [(T[:2, 3] - eye) @ T[:2, 1] / min(forward @ T[:2, 1], -1e-6) for T in frames]
        k = int(np.argmin([r if forward @ T[:2, 1] < 0 else np.inf for r, T in zip(reach, frames)]))
        along = float((eye + reach[k] * forward - frames[k][:2, 3]) @ frames[k][:2, 0])
        free = self._half[k % 2] - 1.0
        return np.asarray(frames[k] @ place(float(np.clip(along, -free, free)), 0))


class CorridorStage(Stage):
    """The floor along the middle of a corridor."""

    def __init__(self, walk: Walk, corridor: Corridor) -> None:
        super().__init__(walk)
        self._path, self._plan = closed_path(corridor.plan.half), corridor.plan

    def ahead(self, t: float, distance: float, angle: float) -> Array:
        eye = self.camera(np.array([t]))[0]
        nearest = int(np.linalg.norm(self._path.points - eye, axis=1).argmin())
        s = self._path.distance[nearest] + distance * np.cos(angle) * 1.6
        at = int(np.searchsorted(self._path.distance, s % self._path.length)) % (len(self._path.points) - 1)
        tangent = self._path.points[at + 1] - self._path.points[at]
        aside = np.array([-tangent[1], tangent[0]]) / np.linalg.norm(tangent)
        free = self._plan.width / 2 - _FROM_SIDE
        return np.asarray(self._path.points[at] + aside * np.clip(distance * np.sin(angle), -free, free))

    def wall(self, t: float) -> Array:
        there = self.ahead(t, 1.6, 0.0)
        frames = [T @ place(1.2, 0) for T in self._plan.doors]
        return np.asarray(min(frames, key=lambda T: float(np.linalg.norm(T[:2, 3] - there))))
