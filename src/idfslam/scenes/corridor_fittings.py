"""Fittings of a corridor, each built in its own frame as in `furniture`: x along the wall, y out of it, z up [m]."""

import numpy as np
from numpy.typing import NDArray

from idfslam.scenes import furniture
from idfslam.scenes import procedural_textures as pattern
from idfslam.scenes.furniture import SceneBuilder, place, tilt
from idfslam.scenes.ray_casting import FRUSTUM

Array = NDArray[np.float64]


def skirting(scene: SceneBuilder, T: Array, along: tuple[float, float], material: int) -> None:
    """A board at the foot of the wall and a rail at the height of a hand."""
    low, high = along
    scene.box(T, (low, 0, 0), (high, 0.014, 0.09), material)
    scene.box(T, (low, 0, 0.92), (high, 0.016, 0.98), material)


def ceiling_lamp(scene: SceneBuilder, T: Array, ceiling: float, power: float = 1.0) -> None:
    """A glowing panel under the ceiling, along x."""
    glass = scene.material(pattern.STRIPES, (0.9, 0.88, 0.82), (0.8, 0.78, 0.73), (0.95, 0.93, 0.88), scale=0.1, contrast=0.3, glow=1.3)
    metal = scene.material(pattern.PAINT, (0.3, 0.3, 0.3), contrast=0.2)
    scene.box(T, (-0.32, -0.17, ceiling - 0.03), (0.32, 0.17, ceiling), metal)
    scene.box(T, (-0.3, -0.15, ceiling - 0.04), (0.3, 0.15, ceiling - 0.03), glass)
    for x in (-0.18, 0.18):
        scene.glowing_disc(T, (x, 0, ceiling - 0.05), 0.05, -1, (1.5 * power, 1.4 * power, 1.2 * power), 1)


def bench(scene: SceneBuilder, T: Array, width: float) -> None:
    """Slats on two iron frames."""
    timber, h = furniture.wood(scene), width / 2
    iron = scene.material(pattern.PAINT, (0.05, 0.05, 0.055), contrast=0.3)
    for k in range(3):
        scene.box(T, (-h, 0.05 + 0.1 * k, 0.42), (h, 0.13 + 0.1 * k, 0.45), timber)
    for x in (-h + 0.12, h - 0.16):
        scene.box(T, (x, 0.06, 0.39), (x + 0.04, 0.32, 0.42), iron)
        for y in (0.06, 0.29):
            scene.box(T, (x, y, 0), (x + 0.04, y + 0.03, 0.39), iron)


def _resting_place(scene: SceneBuilder, T: Array, width: float) -> None:
    """A bench with a picture above it."""
    bench(scene, T, width)
    furniture.picture(scene, T, 0, 1.55, 0.6 * width, 0.5)


def _radiator(scene: SceneBuilder, T: Array, width: float) -> None:
    """Ribs between two pipes."""
    white = scene.material(pattern.PAINT, (0.66, 0.65, 0.6), contrast=0.2, seed=2)
    h = min(width, 0.9) / 2
    for z in (0.18, 0.7):
        scene.box(T, (-h, 0.05, z), (h, 0.09, z + 0.04), white)
    for x in np.arange(-h + 0.02, h - 0.05, 0.08):
        scene.box(T, (x, 0.03, 0.14), (x + 0.05, 0.11, 0.78), white)


def _picture(scene: SceneBuilder, T: Array, width: float) -> None:
    """One picture."""
    furniture.picture(scene, T, scene.rng.uniform(-0.05, 0.05), scene.rng.uniform(1.45, 1.6), 0.75 * width, scene.rng.uniform(0.4, 0.6))


def _row_of_pictures(scene: SceneBuilder, T: Array, width: float) -> None:
    """Two small pictures."""
    for x in (-0.27, 0.27):
        furniture.picture(scene, T, x * width, scene.rng.uniform(1.45, 1.6), 0.32 * width, scene.rng.uniform(0.3, 0.45))


def _notice_board(scene: SceneBuilder, T: Array, width: float) -> None:
    """Cork with sheets of paper on it."""
    rng, h = scene.rng, min(width, 1.0) / 2
    cork = scene.material(pattern.FABRIC, (0.3, 0.18, 0.08), (0.5, 0.33, 0.17))
    frame = furniture.wood(scene)
    scene.box(T, (-h - 0.02, 0, 1.18), (h + 0.02, 0.015, 1.87), frame)
    scene.box(T, (-h, 0.015, 1.2), (h, 0.02, 1.85), cork)
    for k in range(5):
        paper = scene.material(pattern.BOOK, (0.75, 0.74, 0.7), furniture.vivid(rng), (0.08, 0.08, 0.09))
        sheet = T @ place(-h + (k + 0.5) * 2 * h / 5, 0.02, 1.5 + rng.uniform(-0.12, 0.12)) @ tilt(1, rng.uniform(-8, 8))
        scene.box(sheet, (-0.075, 0, -0.105), (0.075, 0.001, 0.105), paper)


def _extinguisher(scene: SceneBuilder, T: Array, width: float) -> None:
    """A red bottle on the wall and its sign."""
    red = scene.material(pattern.PAINT, (0.5, 0.03, 0.02), contrast=0.3)
    black = scene.material(pattern.PAINT, (0.03, 0.03, 0.03), contrast=0.3)
    sign = scene.material(pattern.POSTER, (0.55, 0.03, 0.02), (0.5, 0.04, 0.03))
    scene.tube(T, (0, 0.09, 0.5), 0.42, (0.075, 0.075), red)
    scene.ball(T, (0, 0.09, 0.92), (0.075, 0.075, 0.05), red)
    scene.tube(T, (0, 0.09, 0.95), 0.08, (0.02, 0.02), black)
    scene.box(T, (-0.1, 0, 1.55), (0.1, 0.006, 1.75), sign)


def _clock(scene: SceneBuilder, T: Array, width: float) -> None:
    """A clock with a bin below it."""
    furniture.clock(scene, T, 0, 1.85)
    scene.add(FRUSTUM, T @ place(0, 0.11, 0.25), (0, 0, 0), (0.1, 0.11, 0.25), furniture.cloth(scene))  # a bin below the clock


def exit_sign(scene: SceneBuilder, T: Array, ceiling: float) -> None:
    """A green sign that hangs across the corridor."""
    green = scene.material(pattern.GLAZE, (0.02, 0.35, 0.1), (0.7, 0.75, 0.7), (0.7, 0.75, 0.7), glow=0.7)
    metal = scene.material(pattern.PAINT, (0.3, 0.3, 0.3), contrast=0.2)
    scene.box(T, (-0.02, -0.25, ceiling - 0.32), (0.02, 0.25, ceiling - 0.12), green)
    for y in (-0.2, 0.2):
        scene.tube(T, (0, y, ceiling - 0.12), 0.12, (0.006, 0.006), metal)


THINGS = (_picture, _resting_place, _radiator, _notice_board, _extinguisher, _row_of_pictures, _radiator, _clock, _picture)
"""The things that distinguish places; each function builds one on a wall, in a gap of the given width [m]."""
