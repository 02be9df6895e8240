"""Things that are moved: a chair that is pushed and left elsewhere, a door that opens, a drawer that is pulled out, a ball that rolls."""

import numpy as np
from numpy.typing import NDArray

from idfslam.scenes import furniture
from idfslam.scenes import procedural_textures as pattern
from idfslam.scenes.floor_path import FloorPath
from idfslam.scenes.furniture import SceneBuilder, place, tilt

Array = NDArray[np.float64]

_BALL = 0.16  # [m] radius of a ball; larger: it fills more of the view. This and the rest: chosen by hand
_WIDE_OPEN = 80.0  # [degrees] of an opened door; more: it is opened farther
_PULLED = 0.3  # [m] of an open drawer; more: it is pulled out farther


def eased(seconds: float, start: float, end: float) -> float:
    """From 0 at the time `start` to 1 at `end`, without a jerk."""
    x = min(max((seconds - start) / (end - start), 0.0), 1.0)
    return x * x * (3 - 2 * x)


class PushedChair:
    """A chair that is pushed along a path and left at its end."""

    def __init__(self, materials: SceneBuilder, path: FloorPath) -> None:
        self.path, self._turn = path, float(materials.rng.uniform(0, 360))
        self._timber = furniture.wood(materials)
        self._cloth = furniture.cloth(materials)

    def draw(self, scene: SceneBuilder, seconds: float) -> None:
        """Draws the chair at a time."""
        T = place(*self.path.place(seconds), turn=self._turn + 25 * self.path.distance(seconds))
        furniture.chair(scene, T, self._timber, self._cloth)


class SwivelChair:
    """A chair that turns where it stands by an angle [degrees], from `start` to `end` [s]."""

    def __init__(self, materials: SceneBuilder, at: Array, angle: float, start: float, end: float) -> None:
        """at (2,) [m]: its place on the floor."""
        self.at, self.angle, self.start, self.end = at, angle, start, end
        self._turn = float(materials.rng.uniform(0, 360))
        self._timber = furniture.wood(materials)
        self._cloth = furniture.cloth(materials)

    def draw(self, scene: SceneBuilder, seconds: float) -> None:
        """Draws the chair at a time."""
        turn = self._turn + self.angle * eased(seconds, self.start, self.end)
        furniture.chair(scene, place(float(self.at[0]), float(self.at[1]), turn=turn), self._timber, self._cloth)


class OpenedDoor:
    """A panelled door, hinged at a wall's frame (4, 4) (x along the wall, y into the room), that opens from `start` to `end` [s]."""

    def __init__(self, materials: SceneBuilder, wall: Array, start: float, end: float) -> None:
        self.wall, self.start, self.end = wall, start, end
        self._timber = furniture.wood(materials)
        self._panel = materials.material(pattern.STRIPES, furniture.vivid(materials.rng), (0.6, 0.58, 0.5), (0.2, 0.15, 0.1), scale=0.12)

    def draw(self, scene: SceneBuilder, seconds: float) -> None:
        """Draws the door at a time."""
        hinge = self.wall @ place(-0.4, 0.03) @ tilt(2, _WIDE_OPEN * eased(seconds, self.start, self.end))
        scene.box(hinge, (0, 0, 0.02), (0.8, 0.035, 2.0), self._timber)
        for low, high in ((0.15, 0.9), (1.0, 1.85)):
            for side in (-0.008, 0.035):
                scene.box(hinge, (0.1, side, low), (0.7, side + 0.008, high), self._panel)


class PulledDrawer:
    """A chest at a wall's frame (4, 4), whose upper drawer is pulled out from `start` to `end` [s]."""

    def __init__(self, materials: SceneBuilder, wall: Array, start: float, end: float) -> None:
        self.wall, self.start, self.end = wall, start, end
        self._timber, self._front = furniture.wood(materials), furniture.cloth(materials)

    def draw(self, scene: SceneBuilder, seconds: float) -> None:
        """Draws the chest at a time."""
        scene.box(self.wall, (-0.4, 0.01, 0), (0.4, 0.42, 0.85), self._timber)
        for z, pulled in ((0.08, 0.0), (0.46, _PULLED * eased(seconds, self.start, self.end))):
            scene.box(self.wall, (-0.36, 0.05 + pulled, z), (0.36, 0.45 + pulled, z + 0.33), self._front)


class RollingBall:
    """A ball that rolls along a path."""

    def __init__(self, materials: SceneBuilder, path: FloorPath) -> None:
        self.path = path
        colours = furniture.vivid(materials.rng, 0.3, 0.6), (0.75, 0.72, 0.66), (0.1, 0.1, 0.12)
        self._skin = materials.material(pattern.TILES, *colours, scale=0.12)

    def draw(self, scene: SceneBuilder, seconds: float) -> None:
        """Draws the ball at a time."""
        turn = float(np.rad2deg(self.path.heading(seconds)))
        rolled = float(np.rad2deg(self.path.distance(seconds) / _BALL))
        scene.ball(place(*self.path.place(seconds), _BALL, turn=turn) @ tilt(1, rolled), (0, 0, 0), (_BALL,) * 3, self._skin)
