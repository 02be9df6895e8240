"""People and things that move in generated recordings: who walks where, and what is moved when. The camera knows nothing of them.

So the recording of the same name without them shows the same motion in the same scene with the same noise: their static twin.
"""

import numpy as np
from numpy.random import Generator

from idfslam.datasets.generated.hard_cases import HARD_CASES
from idfslam.datasets.generated.stage import CorridorStage, RoomStage, Stage, Walk
from idfslam.scenes.baked_scene import BakedScene
from idfslam.scenes.corridor import Corridor
from idfslam.scenes.floor_path import FloorPath
from idfslam.scenes.furniture import SceneBuilder
from idfslam.scenes.moved_things import OpenedDoor, PulledDrawer, PushedChair, RollingBall
from idfslam.scenes.moving_scene import AnyScene, Body, MovingScene
from idfslam.scenes.room import Room
from idfslam.scenes.walking_figure import WalkingFigure

PEOPLE, MOVERS = "people", "movers"
"""One to three people; a person, a chair, a door, a drawer and a ball."""

# All of these were chosen by hand.
_AHEAD = 1.1, 2.6  # [m] from the camera to the places that a figure walks to; raised, figures are smaller
_IN_VIEW, _ASIDE = np.deg2rad(22), (np.deg2rad(50), np.deg2rad(100))  # [rad] from the gaze; wider: figures are nearer to its border
_LEAVES = 0.25  # [1] share of the places that lie out of view; raised, figures are seen less
_PACE = 0.9, 1.3  # [m/s] of figures; raised, they are faster
_LEAST_WALK = 1.0  # [s] from one place to the next; raised, short walks are slower
_PAUSE, _PAUSES = (0.6, 2.0), 0.35  # [s] and [1] share of the places where a figure stands; raised, figures stand more
_FIRST_STAND = 2.0  # [s] that the first figure stands before the camera at the beginning; raised, the map learns it longer
_MARGIN = 15.0  # [s] that paths are drawn beyond a recording's end, so that a longer one begins alike; less than a walk would not do
_HEIGHTS = 1.6, 1.9  # [m] of figures; raised, they are taller
_PUSHED, _OPENED, _PULLED = (3.0, 5.5), (6.0, 7.5), (10.0, 11.0)  # [s] from when to when chair, door and drawer move; larger: later
_BALL_EVERY = 4.0  # [s] of one roll of the ball across the view; raised, it is slower


def with_movers(kind: str | None, scene: BakedScene, walk: Walk, seed: int, seconds: float) -> AnyScene:
    """The scene of a recording of this length with PEOPLE, MOVERS or one of HARD_CASES in it; the scene itself for None."""
    if kind is None:
        return scene
    stage: Stage = CorridorStage(walk, scene) if isinstance(scene, Corridor) else RoomStage(walk, _room(scene))
    materials = SceneBuilder(np.random.default_rng([seed, 83]))
    end = seconds + _MARGIN
    if kind in HARD_CASES:
        bodies = HARD_CASES[kind](materials, stage)
    else:
        bodies = _people(materials, stage, seed, end) if kind == PEOPLE else _things(materials, stage, seed, end)
    return MovingScene(scene, bodies, materials.materials)


def _room(scene: BakedScene) -> Room:
    assert isinstance(scene, Room)
    return scene


def _people(materials: SceneBuilder, stage: Stage, seed: int, end: float) -> list[Body]:
    count = int(np.random.default_rng([seed, 89]).integers(1, 4))
    return [_figure(materials, stage, np.random.default_rng([seed, 97, k]), end, first=k == 0) for k in range(count)]


def _things(materials: SceneBuilder, stage: Stage, seed: int, end: float) -> list[Body]:
    rng = np.random.default_rng([seed, 101])
    start, stop = _PUSHED
    a, b = stage.ahead(start, 1.9, rng.uniform(-0.3, -0.1)), stage.ahead(stop, 2.1, rng.uniform(0.1, 0.3))
    pushed = FloorPath(np.array([0, start, stop, end]), np.stack([a, a, b, b]), stage.camera)
    return [
        _figure(materials, stage, np.random.default_rng([seed, 97, 0]), end, first=False),
        PushedChair(materials, pushed),
        OpenedDoor(materials, stage.wall(sum(_OPENED) / 2), *_OPENED),
        PulledDrawer(materials, stage.wall(sum(_PULLED) / 2), *_PULLED),
        RollingBall(materials, _rolls(stage, rng, end)),
    ]


def _figure(materials: SceneBuilder, stage: Stage, rng: Generator, end: float, *, first: bool) -> WalkingFigure:
    """A figure that walks about before the camera. first: it stands in view at the beginning."""
    height = float(rng.uniform(*_HEIGHTS))
    times, places = [0.0], [stage.ahead(0.0, float(rng.uniform(1.3, 1.8)), float(rng.uniform(-0.25, 0.25)) if first else 1.6)]
    if first:
        times, places = [0.0, _FIRST_STAND], places * 2
    while times[-1] < end:
        distance, side = float(rng.uniform(*_AHEAD)), float(rng.choice([-1, 1]))
        angle = side * float(rng.uniform(*_ASIDE) if rng.random() < _LEAVES else rng.uniform(0, _IN_VIEW))
        near = stage.ahead(times[-1] + 2, distance, angle)
        times.append(times[-1] + max(_LEAST_WALK, float(np.linalg.norm(near - places[-1])) / float(rng.uniform(*_PACE))))
        places.append(near)
        stands = float(rng.uniform(*_PAUSE))
        if rng.random() < _PAUSES:
            times.append(times[-1] + stands)
            places.append(near)
    return WalkingFigure(materials, FloorPath(np.array(times), np.stack(places), stage.camera), height)


def _rolls(stage: Stage, rng: Generator, end: float) -> FloorPath:
    """From side to side through the view."""
    times = np.arange(0, end + _BALL_EVERY, _BALL_EVERY)
    side = np.where(np.arange(len(times)) % 2, 1, -1)
    places = [stage.ahead(t, float(rng.uniform(2.3, 3.0)), float(s * rng.uniform(0.35, 0.6))) for t, s in zip(times, side)]
    return FloorPath(times, np.stack(places), stage.camera)
