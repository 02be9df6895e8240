"""A random furnished room: floor, walls, ceiling, and a different set of furniture at every wall."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from idfslam.scenes import furniture
from idfslam.scenes import procedural_textures as pattern
from idfslam.scenes.baked_scene import KEPT, BakedScene, bake
from idfslam.scenes.furniture import Rgb, SceneBuilder, place

Array = NDArray[np.float64]

BARE_WALL = 2  # number of the wall that is bare on request, at y = +half_y
_INNER_CHARTS = ((5,), (4,), (3,), (0,), (2,), (1,))  # charts of floor, ceiling and walls that face the inside


@dataclass(frozen=True)
class Room(BakedScene):
    """A furnished room; the origin is the middle of the floor."""

    half: tuple[float, float]
    """Half the inner length and width [m]."""
    height: float
    """Height of the ceiling [m]."""


@lru_cache(KEPT)
def build_room(seed: int, *, bare_wall: bool = False) -> Room:
    """The room of this seed, not to be changed; with `bare_wall` the middle of one wall is empty and has a single plain colour."""
    rng = np.random.default_rng([seed, 7])
    half, height = (float(rng.uniform(2.45, 3.0)), float(rng.uniform(2.1, 2.5))), float(rng.uniform(2.45, 2.8))
    scene = SceneBuilder(rng)
    _shell(scene, half, height, bare_wall)
    themes = [_sofa_wall if rng.random() < 0.6 else _bed_wall, _library_wall, _window_wall, _door_wall]
    order = rng.permutation(4)
    for k in range(4):
        T, length = wall_frame(k, half), 2 * half[k % 2]
        theme = _bare_wall if bare_wall and k == BARE_WALL else themes[order[k]]
        theme(scene, T, length, height)
        _trim(scene, T, length, height)
    _centre(scene, height)
    return Room(**vars(bake(scene, _INNER_CHARTS)), half=half, height=height)


def wall_frame(k: int, half: tuple[float, float]) -> Array:
    """(4, 4) the frame of wall k: its origin is at the foot of the wall's middle, x along the wall, y into the room, z up."""
    x, y = [(0, -half[1]), (half[0], 0), (0, half[1]), (-half[0], 0)][k]
    return place(x, y, turn=90 * k)


def _shell(scene: SceneBuilder, half: tuple[float, float], height: float, bare_wall: bool) -> None:
    """Floor, ceiling and walls as slabs around the room."""
    rng, T = scene.rng, np.eye(4)
    a, b = half
    light, dark = furniture.WOODS[rng.integers(len(furniture.WOODS))]
    floors = [
        scene.material(pattern.PLANKS, light, dark, (0.03, 0.02, 0.015), scale=float(rng.uniform(0.09, 0.15))),
        scene.material(pattern.TILES, (0.55, 0.5, 0.43), (0.28, 0.2, 0.15), (0.3, 0.29, 0.27), scale=float(rng.uniform(0.25, 0.4))),
        scene.material(pattern.PLANKS, light, dark, (0.03, 0.02, 0.015), scale=0.2),
    ]
    scene.box(T, (-a - 0.1, -b - 0.1, -0.1), (a + 0.1, b + 0.1, 0), floors[rng.integers(3)])
    ceiling = scene.material(pattern.PAINT, (0.78, 0.77, 0.74), contrast=0.22)
    scene.box(T, (-a - 0.1, -b - 0.1, height), (a + 0.1, b + 0.1, height + 0.1), ceiling)
    walls = _wall_materials(scene)
    if bare_wall:
        walls[BARE_WALL] = scene.material(pattern.PAINT, (0.62, 0.6, 0.55), contrast=0.0)
    for k, (low, high) in enumerate(
        [((-a, -b - 0.1), (a, -b)), ((a, -b - 0.1), (a + 0.1, b + 0.1)), ((-a, b), (a, b + 0.1)), ((-a - 0.1, -b - 0.1), (-a, b + 0.1))]
    ):
        scene.box(T, (*low, 0), (*high, height), walls[k])


def _wall_materials(scene: SceneBuilder) -> list[int]:
    """Two painted walls, one with wallpaper, one with stripes or bricks."""
    rng = scene.rng

    def pale() -> Rgb:
        base = np.array(furniture.vivid(rng, 0.3, 0.7))
        base *= 0.5 / base.max()
        r, g, b = 0.4 * base + 0.6 * base.mean() + 0.12
        return float(r), float(g), float(b)

    paint, ground = pale(), pale()
    walls = [
        scene.material(pattern.PAINT, paint, contrast=0.22),
        scene.material(
            pattern.WALLPAPER, ground, furniture.vivid(rng, 0.15, 0.3), furniture.vivid(rng, 0.1, 0.25), scale=float(rng.uniform(0.16, 0.3))
        ),
        scene.material(pattern.PAINT, paint, contrast=0.22),
    ]
    if rng.random() < 0.5:
        walls.append(scene.material(pattern.BRICKS, (0.42, 0.17, 0.09), (0.26, 0.1, 0.06), (0.45, 0.42, 0.38), scale=0.075))
    else:
        walls.append(
            scene.material(
                pattern.STRIPES, ground, furniture.darker(ground, 0.72), furniture.vivid(rng, 0.1, 0.3), scale=0.22, contrast=0.4
            )
        )
    return [walls[i] for i in rng.permutation(4)]


def _trim(scene: SceneBuilder, T: Array, length: float, height: float) -> None:
    """Skirting board and cornice."""
    white = scene.material(pattern.PAINT, (0.68, 0.66, 0.61), contrast=0.2)
    h = length / 2
    scene.box(T, (-h, 0, 0), (h, 0.014, 0.09), white)
    scene.box(T, (-h, 0, height - 0.05), (h, 0.05, height), white)
    scene.box(T, (-h, 0, height - 0.08), (h, 0.025, height - 0.05), white)


def _pictures(scene: SceneBuilder, T: Array, centre: float, z: float, width: float) -> None:
    """One large picture or a row of small ones."""
    rng = scene.rng
    if rng.random() < 0.4:
        furniture.picture(scene, T, centre, z, 0.75 * width, 0.62)
        return
    count = 2 if width < 1.2 else 3
    for k in range(count):
        x = centre + (k - (count - 1) / 2) * width / count
        furniture.picture(scene, T, x, z + rng.uniform(-0.08, 0.08), 0.62 * width / count, rng.uniform(0.36, 0.56))


def _bare_wall(scene: SceneBuilder, T: Array, length: float, height: float) -> None:
    """A bare middle, which the tour faces, with shelves and pictures at the sides."""
    for side in (-1, 1):
        furniture.bookshelf(scene, T @ place(side * (length / 2 - 0.6), 0), 0.42, 1.4)
        furniture.picture(scene, T, side * 1.3, 1.5, 0.28, 0.5)


def _sofa_wall(scene: SceneBuilder, T: Array, length: float, height: float) -> None:
    furniture.sofa(scene, T, scene.rng.uniform(1.7, 2.1))
    _pictures(scene, T, 0.0, 1.6, 1.8)
    furniture.floor_lamp(scene, T @ place(-length / 2 + 0.62, 0.1))
    furniture.plant(scene, T @ place(length / 2 - 0.62, 0.05), scene.rng.uniform(1.2, 1.7))


def _bed_wall(scene: SceneBuilder, T: Array, length: float, height: float) -> None:
    furniture.bed(scene, T, 1.45)
    _pictures(scene, T, 0.0, 1.62, 1.6)
    for side in (-1, 1):
        furniture.table(scene, T @ place(side * 1.08, 0.26), 0.42, 0.42, 0.5)
    furniture.floor_lamp(scene, T @ place(length / 2 - 0.5, 0.0))
    furniture.wall_shelf(scene, T, -length / 2 + 0.65, 1.5, 0.6)


def _library_wall(scene: SceneBuilder, T: Array, length: float, height: float) -> None:
    rng = scene.rng
    wide = length / 2 - 1.0
    furniture.bookshelf(scene, T @ place(-length / 4 - 0.2, 0), wide, rng.uniform(1.75, 2.1))
    furniture.cupboard(scene, T @ place(length / 4 - 0.1, 0), 1.25, rng.uniform(0.75, 0.95))
    _pictures(scene, T, length / 4 - 0.1, 1.65, 1.1)


def _window_wall(scene: SceneBuilder, T: Array, length: float, height: float) -> None:
    rng = scene.rng
    shift = rng.uniform(-0.15, 0.15)
    furniture.window(scene, T @ place(shift, 0), rng.uniform(1.25, 1.5), 1.0, 2.1)
    furniture.desk(scene, T @ place(shift, 0.2), 1.5)
    furniture.plant(scene, T @ place(-length / 2 + 0.55, 0.02), rng.uniform(1.1, 1.6))
    furniture.bookshelf(scene, T @ place(length / 2 - 0.65, 0), 0.42, 1.5)


def _door_wall(scene: SceneBuilder, T: Array, length: float, height: float) -> None:
    rng = scene.rng
    furniture.door(scene, T @ place(-length / 2 + 1.05, 0))
    furniture.clock(scene, T, -length / 2 + 1.95, 1.85)
    furniture.cupboard(scene, T @ place(length / 2 - 1.3, 0), 1.3, rng.uniform(0.7, 0.9))
    furniture.wall_shelf(scene, T, length / 2 - 1.75, 1.5, 0.8)
    furniture.picture(scene, T, length / 2 - 0.85, 1.65, 0.45, 0.6)


def _centre(scene: SceneBuilder, height: float) -> None:
    """A rug, a low table and a lamp in the middle."""
    rng = scene.rng
    turn = rng.uniform(-12, 12)
    T = place(rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1), turn=turn)
    colours = furniture.vivid(rng, 0.05, 0.4), furniture.darker(furniture.vivid(rng), 0.4), (0.6, 0.55, 0.42)
    carpet = scene.material(pattern.RUG, *colours)
    scene.box(T, (-1.15, -0.8, 0), (1.15, 0.8, 0.012), carpet)
    furniture.table(scene, T @ place(0, 0, 0.012), rng.uniform(0.8, 1.0), 0.55, 0.43)
    furniture.pendant(scene, place(0, 0), height)
    stool = scene.material(pattern.STRIPES, furniture.vivid(rng), furniture.vivid(rng), (0.7, 0.66, 0.58), scale=0.06)
    scene.tube(T, (0.78, 0.3, 0.012), 0.36, (0.2, 0.22), stool)
