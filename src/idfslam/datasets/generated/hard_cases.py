"""Single movements that are hard to segment, each alone in a room: one who crosses or pauses, what turns or opens, two who cross."""

from collections.abc import Callable, Sequence

import numpy as np

from idfslam.datasets.generated.stage import Stage
from idfslam.scenes.floor_path import FloorPath
from idfslam.scenes.furniture import SceneBuilder
from idfslam.scenes.moved_things import OpenedDoor, SwivelChair
from idfslam.scenes.moving_scene import Body
from idfslam.scenes.walking_figure import WalkingFigure

HARD_CASE_SECONDS = 6.0  # [s] after which nothing moves any more in a hard case; raised, what moved last stands longer. Chosen by hand

# All of these were chosen by hand.
_HEIGHT = 1.75  # [m] of figures; raised, they are taller
_ASIDE = 1.1  # [rad] from the gaze, where a figure is out of view; raised, it enters and leaves faster
_TURNS = 2.0, 4.0, 120.0  # [s] from when to when a chair turns, and [degrees] by how much; more: it turns faster
_OPENS = 2.0, 3.5  # [s] from when to when a door opens; later: it is shut for longer


def _crossing(materials: SceneBuilder, stage: Stage) -> list[Body]:
    """Walks across at arm's length, and fills half of the view."""
    return [
        _figure(
            materials,
            stage,
            [(0.0, 1.3, _ASIDE), (1.5, 1.3, _ASIDE), (2.3, 1.0, 0.5), (3.0, 1.0, 0.0), (3.7, 1.0, -0.5), (4.5, 1.3, -_ASIDE)],
        )
    ]


def _pausing(materials: SceneBuilder, stage: Stage) -> list[Body]:
    """Comes into view, stands there for 60 frames, and leaves."""
    middle = 3.0
    place = stage.ahead(middle, 1.7, 0.0)
    times = np.array([0.0, 0.6, middle - 1, middle + 1, 5.4, HARD_CASE_SECONDS])
    start, end = stage.ahead(0.6, 1.7, _ASIDE), stage.ahead(5.4, 1.7, -_ASIDE)
    return [WalkingFigure(materials, FloorPath(times, np.stack([start, start, place, place, end, end]), stage.camera), _HEIGHT)]


def _swivelling(materials: SceneBuilder, stage: Stage) -> list[Body]:
    """A chair turns where it stands."""
    start, end, angle = _TURNS
    return [SwivelChair(materials, stage.ahead((start + end) / 2, 1.7, 0.0), angle, start, end)]


def _opening(materials: SceneBuilder, stage: Stage) -> list[Body]:
    """A door opens and stays open."""
    return [OpenedDoor(materials, stage.wall(sum(_OPENS) / 2), *_OPENS)]


def _pair(materials: SceneBuilder, stage: Stage) -> list[Body]:
    """Two cross the view in opposite directions, one behind the other."""
    near = [(0.0, 1.3, _ASIDE), (1.5, 1.3, _ASIDE), (3.0, 1.3, 0.0), (4.5, 1.3, -_ASIDE)]
    far = [(0.0, 2.1, -_ASIDE), (1.5, 2.1, -_ASIDE), (3.0, 2.1, 0.0), (4.5, 2.1, _ASIDE)]
    return [_figure(materials, stage, near), _figure(materials, stage, far)]


def _figure(materials: SceneBuilder, stage: Stage, walk: Sequence[tuple[float, float, float]]) -> WalkingFigure:
    """A figure that is seen at times [s] at distances [m] and angles [rad] from the gaze."""
    places = [stage.ahead(*seen) for seen in walk]
    times = np.array([*(t for t, _, _ in walk), HARD_CASE_SECONDS])
    return WalkingFigure(materials, FloorPath(times, np.stack([*places, places[-1]]), stage.camera), _HEIGHT)


HARD_CASES: dict[str, Callable[[SceneBuilder, Stage], list[Body]]] = {
    "crossing": _crossing,
    "pausing": _pausing,
    "swivelling": _swivelling,
    "opening": _opening,
    "pair": _pair,
}
"""Each case by its name: what moves."""
