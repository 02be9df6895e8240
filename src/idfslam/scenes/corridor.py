"""A random corridor around a block: four straight stretches with rooms and niches, and doors that look alike.

The doors have equal distances on all four sides, one shape and one material, so that many places look alike. A few pictures, benches,
plants, radiators and signs distinguish them. The origin is the middle of the block, on the floor.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from idfslam.scenes import corridor_fittings as fittings
from idfslam.scenes import furniture
from idfslam.scenes import procedural_textures as pattern
from idfslam.scenes.baked_scene import KEPT, BakedScene, bake
from idfslam.scenes.furniture import Rgb, SceneBuilder, place
from idfslam.scenes.room import wall_frame

Array = NDArray[np.float64]

HEIGHT = 2.5  # [m] of the ceiling
DOOR_SPACING = 2.4  # [m] between the middles of doors
_LONG, _SHORT = (-1.5, -0.5, 0.5, 1.5), (-1.0, 0.0, 1.0)  # positions of doors on long and short outer walls, in spacings from the middle
_THICK = 0.1  # [m] thickness of walls
_ROOM, _NICHE = (1.1, 2.1, 2.3, 2.0), (1.4, 2.2, 1.4, 0.45)  # width and height of the opening, width and depth behind it [m]


@dataclass(frozen=True)
class FloorPlan:
    """The floor plan."""

    half: tuple[float, float]
    """Half the length and width of the rectangle along the middle of the corridor [m]."""
    width: float
    """Width of the corridor [m]."""
    doors: list[Array] = field(default_factory=list)
    """(4, 4) frames of the look-alike doors: x along the wall, y into the corridor."""
    openings: list[Array] = field(default_factory=list)
    """(4, 4) frames of the openings to rooms and niches, with the same axes; one on each side."""

    def outer(self, k: int) -> tuple[Array, float]:
        """Frame (4, 4) and length [m] of the outer wall of side k."""
        a, b = (h + self.width / 2 for h in self.half)
        return wall_frame(k, (a, b)), 2 * (a, b)[k % 2]

    def block(self, k: int) -> tuple[Array, float]:
        """Frame (4, 4) and length [m] of the block's wall on side k."""
        a, b = (h - self.width / 2 for h in self.half)
        return wall_frame(k, (a, b)) @ place(0, 0, turn=180), 2 * (a, b)[k % 2]


@dataclass(frozen=True)
class Corridor(BakedScene):
    """A finished corridor."""

    plan: FloorPlan


@dataclass(frozen=True)
class Building:
    """A corridor without light: its shapes, and the visible charts of the slabs, which are the first shapes."""

    plan: FloorPlan
    scene: SceneBuilder
    inner: list[tuple[int, ...]] = field(default_factory=list)

    def slab(self, T: Array, low: tuple[float, float, float], high: tuple[float, float, float], material: int, *inner: int) -> None:
        """Adds a part of a floor, wall or ceiling; `inner` are its visible charts."""
        self.scene.box(T, low, high, material)
        self.inner.append(inner)


@lru_cache(KEPT)
def build_corridor(seed: int) -> Corridor:
    """The corridor of this seed, not to be changed: 25.6 to 30.8 m around along its middle, 1.7 to 2.1 m wide."""
    building = draw_corridor(seed)
    return Corridor(**vars(bake(building.scene, building.inner)), plan=building.plan)


def draw_corridor(seed: int) -> Building:
    """The corridor of this seed without light; baking the light takes most of the time."""
    rng = np.random.default_rng([seed, 17])
    half = float(rng.uniform(3.7, 4.4)), float(rng.uniform(2.7, 3.3))
    building = Building(FloorPlan(half, float(rng.uniform(1.7, 2.1))), SceneBuilder(rng))
    openings = _draw_openings(rng)
    walls = _wall_materials(building.scene)
    _floors_and_ceilings(building)
    _block(building, walls)
    for k in range(4):
        _outer_wall(building, k, openings[k], walls[k % 2])
    for k, (slot, kind) in enumerate(openings):
        _behind(building, k, slot * DOOR_SPACING, kind, walls[2])
    _furnish(building, openings)
    return building


def _draw_openings(rng: Generator) -> list[tuple[float, tuple[float, ...]]]:
    """For each side the position of its opening, in door spacings, and the kind of space behind it: two rooms, two niches."""
    kinds = [(_ROOM, _NICHE, _ROOM, _NICHE), (_NICHE, _ROOM, _NICHE, _ROOM), (_ROOM, _ROOM, _NICHE, _NICHE)][rng.integers(3)]
    return [(float(rng.choice(_SHORT if k % 2 else _LONG)), kind) for k, kind in enumerate(kinds)]


def _wall_materials(scene: SceneBuilder) -> list[int]:
    """Materials: paint of the long sides, of the short sides, of rooms and niches, and a pattern for one end of the block."""
    rng = scene.rng

    def pale() -> Rgb:
        base = np.array(furniture.vivid(rng, 0.3, 0.7))
        r, g, b = 0.25 * base / base.max() + 0.25
        return float(r), float(g), float(b)

    walls = [scene.material(pattern.PAINT, pale(), contrast=0.22) for _ in range(3)]
    if rng.random() < 0.5:
        bricks = (0.42, 0.17, 0.09), (0.26, 0.1, 0.06), (0.45, 0.42, 0.38)
        return [*walls, scene.material(pattern.BRICKS, *bricks, scale=0.075)]
    flowers = furniture.vivid(rng, 0.15, 0.3), furniture.vivid(rng, 0.1, 0.25)
    return [*walls, scene.material(pattern.WALLPAPER, pale(), *flowers, scale=float(rng.uniform(0.2, 0.3)))]


def _floors_and_ceilings(building: Building) -> None:
    """Four strips: the long sides have one floor, the short ones another."""
    scene, rng = building.scene, building.scene.rng
    light, dark = furniture.WOODS[rng.integers(len(furniture.WOODS))]
    grout = (0.3, 0.29, 0.27)
    floors = [
        scene.material(pattern.TILES, (0.5, 0.46, 0.4), (0.33, 0.27, 0.21), grout, scale=float(rng.uniform(0.28, 0.4))),
        scene.material(pattern.PLANKS, light, dark, (0.03, 0.02, 0.015), scale=float(rng.uniform(0.1, 0.16))),
    ]
    floors = floors[:: rng.choice([-1, 1])]
    ceiling = scene.material(pattern.TILES, (0.72, 0.71, 0.68), (0.7, 0.69, 0.66), (0.5, 0.5, 0.48), scale=0.6, contrast=0.12)
    w = building.plan.width
    for k in range(4):
        T, length = building.plan.outer(k)
        h = length / 2 if k % 2 == 0 else length / 2 - w
        building.slab(T, (-h, 0, -_THICK), (h, w, 0), floors[k % 2], 5)
        building.slab(T, (-h, 0, HEIGHT), (h, w, HEIGHT + _THICK), ceiling, 4)


def _block(building: Building, walls: list[int]) -> None:
    """The block: painted, its ends in other materials a centimetre thick."""
    (a, b), end = (h - building.plan.width / 2 for h in building.plan.half), 0.01
    building.slab(np.eye(4), (-a + end, -b, 0), (a - end, b, HEIGHT), walls[0], 2, 3)
    ends = [walls[1], walls[3]][:: building.scene.rng.choice([-1, 1])]
    building.slab(np.eye(4), (-a, -b, 0), (-a + end, b, HEIGHT), ends[0], 0, 2, 3)
    building.slab(np.eye(4), (a - end, -b, 0), (a, b, HEIGHT), ends[1], 1, 2, 3)


def _outer_wall(building: Building, k: int, opening: tuple[float, tuple[float, ...]], paint: int) -> None:
    """A wall with its opening."""
    T, length = building.plan.outer(k)
    x, (wide, high, _, _) = opening[0] * DOOR_SPACING, opening[1]
    h = length / 2 + (_THICK if k % 2 else 0.5)  # rooms of the long sides may reach past the corner
    low, top = -_THICK, HEIGHT + _THICK
    building.slab(T, (-h, -_THICK, low), (x - wide / 2, 0, top), paint, 1, 2, 3)
    building.slab(T, (x + wide / 2, -_THICK, low), (h, 0, top), paint, 0, 2, 3)
    building.slab(T, (x - wide / 2, -_THICK, high), (x + wide / 2, 0, top), paint, 2, 3, 4)
    building.plan.openings.append(T @ place(x, 0))


def _behind(building: Building, k: int, x: float, kind: tuple[float, ...], paint: int) -> None:
    """Floor, walls and ceiling behind the opening at `x` of side k."""
    T, (_, high, width, depth) = building.plan.outer(k)[0] @ place(x, 0), kind
    h, back, top = width / 2, -_THICK - depth, HEIGHT if kind is _ROOM else high
    floor = building.scene.material(pattern.FABRIC, furniture.vivid(building.scene.rng, 0.15, 0.3), (0.45, 0.42, 0.38))
    building.slab(T, (-h, back, -_THICK), (h, 0, 0), floor, 5)
    building.slab(T, (-h, back, top), (h, -_THICK, top + _THICK), paint, 4)
    building.slab(T, (-h - _THICK, back - _THICK, -_THICK), (h + _THICK, back, top + _THICK), paint, 3)
    building.slab(T, (-h - _THICK, back, -_THICK), (-h, -_THICK, top + _THICK), paint, 1)
    building.slab(T, (h, back, -_THICK), (h + _THICK, -_THICK, top + _THICK), paint, 0)


def _furnish(building: Building, openings: list[tuple[float, tuple[float, ...]]]) -> None:
    """Adds doors, lamps, skirting boards, furniture in rooms and niches, and things that distinguish places."""
    scene, rng = building.scene, building.scene.rng
    timber = scene.material(pattern.WOOD, *furniture.WOODS[rng.integers(len(furniture.WOODS))], seed=1)
    white = scene.material(pattern.PAINT, (0.6, 0.58, 0.53), contrast=0.2)
    for k, (slot, kind) in enumerate(openings):
        (T, length), (T_block, length_block) = building.plan.outer(k), building.plan.block(k)
        places = _SHORT if k % 2 else _LONG
        frames = [T @ place(x * DOOR_SPACING, 0) for x in places if x != slot]
        frames += [T_block @ place(x * DOOR_SPACING, 0) for x in ((0.0,) if k % 2 else (-0.5, 0.5))]
        for frame in frames:
            furniture.door(scene, frame, timber)
        building.plan.doors.extend(frames)
        x, wide = slot * DOOR_SPACING, kind[0]
        fittings.skirting(scene, T, (-length / 2, x - wide / 2), white)
        fittings.skirting(scene, T, (x + wide / 2, length / 2), white)
        fittings.skirting(scene, T_block, (-length_block / 2, length_block / 2), white)
        for lamp in places[:: 1 if k % 2 == 0 else 2]:
            fittings.ceiling_lamp(scene, T @ place((lamp + 0.5 * (k % 2 == 0)) * DOOR_SPACING * 0.98, building.plan.width / 2), HEIGHT)
        (_furnish_room if kind is _ROOM else _furnish_niche)(scene, T @ place(x, -_THICK - kind[3]), k)
    _mark_places(building, openings)


def _furnish_room(scene: SceneBuilder, T: Array, k: int) -> None:
    """A window with a desk before it, or a library; a lamp of its own."""
    if k % 2 == 0:
        furniture.window(scene, T, 1.2, 1.0, 2.0)
        furniture.desk(scene, T @ place(0, 0.15), 1.3)
    else:
        furniture.bookshelf(scene, T @ place(0.3, 0), 1.3, 1.9)
        furniture.plant(scene, T @ place(-0.75, 0.02), 1.4)
    fittings.ceiling_lamp(scene, T @ place(0, 1.2), HEIGHT)


def _furnish_niche(scene: SceneBuilder, T: Array, k: int) -> None:
    """A cupboard or a bench below a picture, with a lamp."""
    fittings.ceiling_lamp(scene, T @ place(0, _NICHE[3] / 2), _NICHE[1], power=0.3)
    if scene.rng.random() < 0.5:
        furniture.cupboard(scene, T, 1.2, 0.8)
        furniture.picture(scene, T, 0.0, 1.6, 0.9, 0.5)
    else:
        fittings.bench(scene, T, 1.2)
        furniture.picture(scene, T, 0.0, 1.45, 1.0, 0.7)


def _mark_places(building: Building, openings: list[tuple[float, tuple[float, ...]]]) -> None:
    """Adds things in two thirds of the gaps between doors, plants in two corners and an exit sign."""
    scene, rng = building.scene, building.scene.rng
    gaps = []
    for k, (slot, kind) in enumerate(openings):
        T, T_block, reach = building.plan.outer(k)[0], building.plan.block(k)[0], building.plan.block(k)[1] / 2
        middles = (-0.5, 0.5) if k % 2 else (-1.0, 0.0, 1.0)
        free = 0.5 * DOOR_SPACING - 0.1 + kind[0] / 2  # distance from an opening beyond which wide things fit
        gaps += [(T @ place(x * DOOR_SPACING, 0), 1.2 if abs(x - slot) * DOOR_SPACING > free else 0.7) for x in middles]
        gaps += [(T_block @ place(x, 0), 0.7) for x in ((-(reach + 0.5) / 2, (reach + 0.5) / 2) if k % 2 else (0.0,))]
    for i, gap in enumerate(rng.permutation(len(gaps))[: len(gaps) * 2 // 3]):
        fittings.THINGS[i % len(fittings.THINGS)](scene, *gaps[gap])
    for k in rng.permutation(4)[:2]:
        T, length = building.plan.outer(int(k))
        furniture.plant(scene, T @ place(length / 2 - 0.38, 0.06), rng.uniform(1.1, 1.7))
    T, length = building.plan.outer(int(rng.integers(4)))
    fittings.exit_sign(scene, T @ place(length / 2 - building.plan.width, building.plan.width / 2), HEIGHT)
