"""Furniture out of boxes, frustums and ellipsoids.

A piece is built in its own frame: x along the wall, y out of it into the room, z up, the origin on the floor at the
wall [m]. A `SceneBuilder` collects the shapes of all pieces.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from idfslam.scenes import procedural_textures as pattern
from idfslam.scenes.ray_casting import BOX, ELLIPSOID, FRUSTUM

Array = NDArray[np.float64]
Rgb = tuple[float, float, float]


def place(x: float, y: float, z: float = 0.0, *, turn: float = 0.0) -> Array:
    """(4, 4) a frame at (x, y, z) [m], turned about z [degrees]."""
    c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])


def tilt(axis: int, degrees: float) -> Array:
    """(4, 4) a rotation about x (0), y (1) or z (2)."""
    out = np.eye(4)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    out[i, i] = out[j, j] = c
    out[i, j], out[j, i] = -s, s
    return out


@dataclass
class SceneBuilder:
    """A scene under construction: shapes, materials and lights; `rng` draws random details."""

    rng: Generator
    shapes: list[Array] = field(default_factory=list)
    materials: list[Array] = field(default_factory=list)
    lights: list[Array] = field(default_factory=list)

    def material(
        self, kind: int, a: Rgb, b: Rgb | None = None, c: Rgb | None = None,
        *, scale: float = 0.1, contrast: float = 1.0, glow: float = 0.0, seed: int = -1,
    ) -> int:  # fmt: skip
        """Adds a material with a pattern of `procedural_textures` and colours in linear RGB; returns its number.

        With a `seed` >= 0 all shapes of this material have the same texture; without, each has its own.
        """
        self.materials.append(np.array([kind, scale, contrast, glow, *a, *(b or a), *(c or b or a), seed]))
        return len(self.materials) - 1

    def add(self, kind: int, T: Array, centre: tuple[float, float, float], sizes: tuple[float, float, float], material: int) -> None:
        """Adds a shape with its `centre` and axes in the frame T."""
        position = T[:3, :3] @ np.array(centre) + T[:3, 3]
        self.shapes.append(np.concatenate([[kind], sizes, position, T[:3, :3].ravel(), [material]]))

    def box(self, T: Array, low: tuple[float, float, float], high: tuple[float, float, float], material: int) -> None:
        """Adds a box between two corners."""
        a, b = np.array(low), np.array(high)
        self.add(BOX, T, tuple((a + b) / 2), tuple((b - a) / 2), material)

    def tube(self, T: Array, base: tuple[float, float, float], height: float, radii: tuple[float, float], material: int) -> None:
        """Adds a cylinder or cone that stands on `base`."""
        self.add(FRUSTUM, T, (base[0], base[1], base[2] + height / 2), (radii[0], radii[1], height / 2), material)

    def ball(self, T: Array, centre: tuple[float, float, float], radii: tuple[float, float, float], material: int) -> None:
        """Adds an ellipsoid."""
        self.add(ELLIPSOID, T, centre, radii, material)

    def glowing_disc(self, T: Array, centre: tuple[float, float, float], radius: float, normal: float, power: Rgb, samples: int) -> None:
        """Adds a round area light facing up (`normal` 1) or down (-1); `power` is the total of all samples."""
        for k in range(samples):
            r, phi = radius * np.sqrt((k + 0.5) / samples), k * 2.39996
            point = T @ np.array([centre[0] + r * np.cos(phi), centre[1] + r * np.sin(phi), centre[2], 1.0])
            self.lights.append(np.concatenate([point[:3], [0, 0, normal], np.array(power) / samples]))


PIGMENTS: tuple[Rgb, ...] = (
    (0.45, 0.13, 0.06),  # terracotta
    (0.52, 0.32, 0.08),  # ochre
    (0.035, 0.07, 0.2),  # navy
    (0.05, 0.16, 0.07),  # forest
    (0.04, 0.22, 0.24),  # teal
    (0.28, 0.03, 0.05),  # burgundy
    (0.55, 0.47, 0.34),  # cream
    (0.06, 0.06, 0.065),  # charcoal
    (0.42, 0.22, 0.2),  # dusty rose
    (0.24, 0.3, 0.18),  # sage
    (0.16, 0.26, 0.4),  # dusk blue
    (0.22, 0.1, 0.2),  # plum
    (0.33, 0.2, 0.11),  # leather
    (0.4, 0.38, 0.34),  # stone
)


def vivid(rng: Generator, low: float = 0.05, high: float = 0.55) -> Rgb:
    """A random pigment with a slightly varied hue; its largest component lies between `low` and `high`."""
    colour = np.array(PIGMENTS[rng.integers(len(PIGMENTS))]) * rng.uniform(0.75, 1.3, 3)
    r, g, b = colour * np.clip(colour.max(), low, high) / colour.max()
    return float(r), float(g), float(b)


def darker(colour: Rgb, k: float) -> Rgb:
    """A colour times k."""
    return colour[0] * k, colour[1] * k, colour[2] * k


WOODS: tuple[tuple[Rgb, Rgb], ...] = (
    ((0.52, 0.33, 0.17), (0.27, 0.14, 0.06)),
    ((0.30, 0.16, 0.08), (0.12, 0.055, 0.025)),
    ((0.68, 0.52, 0.33), (0.42, 0.27, 0.13)),
    ((0.40, 0.20, 0.10), (0.20, 0.08, 0.035)),
    ((0.62, 0.58, 0.50), (0.38, 0.33, 0.27)),
)


def wood(scene: SceneBuilder) -> int:
    """A kind of wood."""
    a, b = WOODS[scene.rng.integers(len(WOODS))]
    return scene.material(pattern.WOOD, a, b)


def cloth(scene: SceneBuilder, colour: Rgb | None = None) -> int:
    """Plain or striped fabric."""
    rng = scene.rng
    a = colour or vivid(rng)
    if rng.random() < 0.4:
        return scene.material(pattern.STRIPES, a, vivid(rng), (0.7, 0.66, 0.58), scale=rng.uniform(0.05, 0.12))
    return scene.material(pattern.FABRIC, darker(a, 0.65), darker(a, 1.35))


def vase(scene: SceneBuilder, T: Array, x: float, y: float, z: float, size: float) -> None:
    """A glazed vase with a neck, or sometimes a ball, `size` [m] high."""
    rng = scene.rng
    glaze = scene.material(pattern.GLAZE, vivid(rng), vivid(rng), vivid(rng, 0.4, 0.7), contrast=float(rng.integers(4)))
    r = 0.3 * size
    if rng.random() < 0.3:
        scene.ball(T, (x, y, z + 0.36 * size), (0.36 * size,) * 3, glaze)
        return
    scene.tube(T, (x, y, z), 0.1 * size, (0.6 * r, 0.75 * r), glaze)
    scene.ball(T, (x, y, z + 0.42 * size), (r, r, 0.36 * size), glaze)
    scene.tube(T, (x, y, z + 0.7 * size), 0.3 * size, (0.45 * r, 0.75 * r), glaze)


def books(scene: SceneBuilder, T: Array, low: float, high: float, y: float, z: float, height: float) -> None:
    """A row of books between x = low and high, their spines near y, on a board at z with `height` above it."""
    rng = scene.rng
    x = low
    while x < high - 0.06:
        if rng.random() < 0.12:
            x += rng.uniform(0.03, 0.12)
            continue
        thick, tall, deep = rng.uniform(0.018, 0.05), height * rng.uniform(0.6, 0.92), rng.uniform(0.14, 0.2)
        cover = scene.material(pattern.BOOK, vivid(rng, 0.03, 0.45), vivid(rng), (0.75, 0.68, 0.45))
        front = y - rng.uniform(0.0, 0.03)
        scene.box(T, (x, front - deep, z), (x + thick, front, z + tall), cover)
        x += thick + 0.001


def bookshelf(scene: SceneBuilder, T: Array, width: float, height: float) -> None:
    """Boards between sides, with books, vases and boxes."""
    rng, timber, depth = scene.rng, wood(scene), 0.3
    h = width / 2
    scene.box(T, (-h, 0, 0), (-h + 0.025, depth, height), timber)
    scene.box(T, (h - 0.025, 0, 0), (h, depth, height), timber)
    scene.box(T, (-h + 0.025, 0, 0), (h - 0.025, 0.012, height), timber)
    levels = max(2, round(height / 0.36))
    step = (height - 0.1) / levels
    for k in range(levels + 1):
        z = 0.06 + k * step
        scene.box(T, (-h + 0.025, 0.012, z), (h - 0.025, depth - 0.01, z + 0.022), timber)
        if k == levels:
            break
        split = rng.uniform(-0.5, 0.5) * h
        books(scene, T, -h + 0.03, split, depth - 0.03, z + 0.022, step - 0.03)
        if rng.random() < 0.5:
            books(scene, T, split + 0.03, h - 0.03, depth - 0.03, z + 0.022, step - 0.03)
        else:
            vase(scene, T, (split + h) / 2, 0.16, z + 0.022, 0.75 * (step - 0.03))
    vase(scene, T, rng.uniform(-0.5, 0.5) * h, 0.15, height, 0.26)


def cupboard(scene: SceneBuilder, T: Array, width: float, height: float) -> None:
    """A body on feet with panelled doors and knobs, things on top."""
    rng, timber, depth, h = scene.rng, wood(scene), 0.42, width / 2
    knob = scene.material(pattern.PAINT, (0.55, 0.42, 0.18), contrast=0.2)
    scene.box(T, (-h, 0, 0.08), (h, depth, height), timber)
    scene.box(T, (-h - 0.02, 0, height), (h + 0.02, depth + 0.02, height + 0.03), timber)
    for x in (-h + 0.04, h - 0.04):
        for y in (0.04, depth - 0.04):
            scene.tube(T, (x, y, 0), 0.08, (0.02, 0.03), timber)
    doors = max(2, round(width / 0.45))
    panel = scene.material(pattern.WOOD, *WOODS[rng.integers(len(WOODS))])
    for k in range(doors):
        low, high = -h + k * width / doors + 0.02, -h + (k + 1) * width / doors - 0.02
        scene.box(T, (low, depth, 0.11), (high, depth + 0.018, height - 0.03), timber)
        scene.box(T, (low + 0.06, depth + 0.018, 0.18), (high - 0.06, depth + 0.026, height - 0.1), panel)
        scene.ball(T, (high - 0.03 if k % 2 == 0 else low + 0.03, depth + 0.035, height * 0.55), (0.016,) * 3, knob)
    for x in (-0.6 * h, 0.1 * h, 0.7 * h):
        vase(scene, T, x + rng.uniform(-0.05, 0.05), depth / 2, height + 0.03, rng.uniform(0.16, 0.34))


def sofa(scene: SceneBuilder, T: Array, width: float) -> None:
    """Base, back, arms and cushions."""
    rng, h = scene.rng, width / 2
    cover = cloth(scene)
    feet = wood(scene)
    scene.box(T, (-h, 0.05, 0.1), (h, 0.85, 0.28), cover)
    scene.box(T @ place(0, 0.16, 0.28) @ tilt(0, 8), (-h + 0.16, -0.1, 0), (h - 0.16, 0.1, 0.52), cover)
    for side in (-1, 1):
        scene.box(T, (min(side * h, side * (h - 0.16)), 0.05, 0.28), (max(side * h, side * (h - 0.16)), 0.85, 0.5), cover)
        scene.add(FRUSTUM, T @ place(side * (h - 0.08), 0.45, 0.5) @ tilt(0, 90), (0, 0, 0), (0.08, 0.08, 0.4), cover)
        for y in (0.12, 0.78):
            scene.tube(T, (side * (h - 0.08), y, 0), 0.1, (0.02, 0.03), feet)
    seats = max(2, round((width - 0.32) / 0.65))
    for k in range(seats):
        low = -h + 0.165 + k * (width - 0.33) / seats
        scene.box(T, (low, 0.24, 0.28), (low + (width - 0.33) / seats - 0.01, 0.87, 0.43), cover)
    for _ in range(rng.integers(2, 4)):
        x = rng.uniform(-0.65, 0.65) * h
        scene.ball(T @ place(x, 0.42, 0.6, turn=rng.uniform(-25, 25)) @ tilt(0, 22), (0, 0, 0), (0.21, 0.08, 0.2), cloth(scene))


def bed(scene: SceneBuilder, T: Array, width: float) -> None:
    """Headboard at the wall, mattress, blanket and pillows."""
    timber, h, rng = wood(scene), width / 2, scene.rng
    linen = scene.material(pattern.FABRIC, (0.62, 0.6, 0.56), (0.78, 0.76, 0.72), contrast=0.6)
    scene.box(T, (-h - 0.04, 0, 0), (h + 0.04, 0.06, 1.0), timber)
    scene.box(T, (-h - 0.02, 0.06, 0.12), (h + 0.02, 1.62, 0.32), timber)
    for side in (-1, 1):
        scene.tube(T, (side * (h - 0.05), 1.5, 0), 0.12, (0.03, 0.04), timber)
    scene.box(T, (-h, 0.06, 0.32), (h, 1.6, 0.5), linen)
    scene.box(T, (-h - 0.03, 0.62, 0.3), (h + 0.03, 1.64, 0.53), cloth(scene))
    for x in (-0.5 * h, 0.5 * h):
        scene.ball(T @ place(x, 0.3, 0.56) @ tilt(0, 25), (0, 0, 0), (0.38 * h, 0.2, 0.09), linen)
    scene.ball(T @ place(rng.uniform(-0.2, 0.2), 0.5, 0.62) @ tilt(0, 50), (0, 0, 0), (0.22, 0.17, 0.07), cloth(scene))


def table(scene: SceneBuilder, T: Array, width: float, depth: float, height: float) -> None:
    """A rectangular table, its centre at the origin, set with things."""
    timber, rng = wood(scene), scene.rng
    a, b = width / 2, depth / 2
    scene.box(T, (-a, -b, height - 0.035), (a, b, height), timber)
    scene.box(T, (-a + 0.06, -b + 0.06, height - 0.11), (a - 0.06, b - 0.06, height - 0.035), timber)
    for x in (-a + 0.06, a - 0.06):
        for y in (-b + 0.06, b - 0.06):
            scene.tube(T, (x, y, 0), height - 0.035, (0.02, 0.032), timber)
    vase(scene, T, rng.uniform(-0.3, 0.0) * a, rng.uniform(-0.4, 0.4) * b, height, rng.uniform(0.2, 0.3))
    z = height
    for _ in range(rng.integers(2, 5)):
        cover = scene.material(pattern.BOOK, vivid(rng, 0.03, 0.45), vivid(rng), (0.75, 0.68, 0.45))
        stack = T @ place(0.5 * a, 0.2 * b, z, turn=rng.uniform(-20, 20)) @ tilt(1, 90)
        thick = rng.uniform(0.018, 0.04)
        scene.box(stack, (-thick, -0.08, -0.11), (0, 0.08, 0.11), cover)
        z += thick
    bowl = scene.material(pattern.GLAZE, vivid(rng), vivid(rng), (0.7, 0.7, 0.66))
    scene.tube(T, (-0.6 * a, -0.3 * b, height), 0.06, (0.05, 0.11), bowl)
    for k in range(3):
        fruit = scene.material(pattern.PAINT, vivid(rng, 0.03, 0.6), contrast=0.5)
        scene.ball(T, (-0.6 * a + 0.045 * np.cos(2.1 * k), -0.3 * b + 0.045 * np.sin(2.1 * k), height + 0.075), (0.035,) * 3, fruit)


def chair(scene: SceneBuilder, T: Array, timber: int, cushion: int | None = None) -> None:
    """Seat, legs and a back of slats; it looks towards -y. cushion: the material of the seat; None: any cloth."""
    scene.box(T, (-0.21, -0.21, 0.42), (0.21, 0.21, 0.45), timber)
    scene.box(T, (-0.19, -0.19, 0.45), (0.19, 0.17, 0.48), cloth(scene) if cushion is None else cushion)
    for x in (-0.18, 0.18):
        scene.tube(T, (x, -0.18, 0), 0.42, (0.016, 0.022), timber)
        scene.tube(T, (x, 0.19, 0), 0.9, (0.018, 0.018), timber)
    for z in (0.58, 0.7, 0.82):
        scene.box(T, (-0.17, 0.18, z), (0.17, 0.2, z + 0.06), timber)


def desk(scene: SceneBuilder, T: Array, width: float) -> None:
    """A table at the wall with drawers, a screen, a lamp, books and a chair before it."""
    rng, timber, h = scene.rng, wood(scene), width / 2
    scene.box(T, (-h, 0.02, 0.71), (h, 0.65, 0.74), timber)
    scene.box(T, (h - 0.4, 0.04, 0.1), (h - 0.03, 0.6, 0.71), timber)
    knob = scene.material(pattern.PAINT, (0.6, 0.5, 0.3), contrast=0.2)
    for z in (0.14, 0.34, 0.54):
        scene.box(T, (h - 0.38, 0.6, z), (h - 0.05, 0.615, z + 0.16), timber)
        scene.ball(T, (h - 0.215, 0.625, z + 0.08), (0.014,) * 3, knob)
    for y in (0.08, 0.58):
        scene.tube(T, (-h + 0.06, y, 0), 0.71, (0.022, 0.03), timber)
    dark = scene.material(pattern.PAINT, (0.03, 0.03, 0.035), contrast=0.3)
    picture = scene.material(pattern.LANDSCAPE, vivid(rng), vivid(rng), vivid(rng), glow=0.6)
    scene.box(T, (-0.28, 0.2, 0.86), (0.28, 0.23, 1.2), dark)
    scene.box(T, (-0.26, 0.23, 0.88), (0.26, 0.232, 1.18), picture)
    scene.tube(T, (0, 0.2, 0.74), 0.13, (0.03, 0.02), dark)
    scene.tube(T, (0, 0.2, 0.74), 0.012, (0.12, 0.12), dark)
    books(scene, T, -h + 0.05, -0.33, 0.28, 0.74, 0.26)
    scene.box(
        T @ place(0.0, 0.48, 0.74, turn=4),
        (-0.2, -0.07, 0),
        (0.2, 0.07, 0.02),
        scene.material(pattern.TILES, (0.25,) * 3, (0.18,) * 3, (0.03,) * 3, scale=0.025),
    )
    vase(scene, T, h - 0.2, 0.3, 0.74, 0.22)
    chair(scene, T @ place(rng.uniform(-0.1, 0.1), 0.72, turn=rng.uniform(-20, 20)), timber)


def floor_lamp(scene: SceneBuilder, T: Array) -> None:
    """A stand with a glowing shade."""
    metal = scene.material(pattern.PAINT, (0.25, 0.22, 0.18), contrast=0.3)
    shade = scene.material(pattern.STRIPES, (0.9, 0.72, 0.45), (0.85, 0.6, 0.33), (0.9, 0.8, 0.6), scale=0.06, contrast=0.5, glow=1.1)
    scene.tube(T, (0, 0.25, 0), 0.03, (0.14, 0.12), metal)
    scene.tube(T, (0, 0.25, 0.03), 1.35, (0.012, 0.012), metal)
    scene.tube(T, (0, 0.25, 1.38), 0.26, (0.18, 0.12), shade)
    scene.glowing_disc(T, (0, 0.25, 1.37), 0.17, -1, (0.5, 0.38, 0.22), 5)
    scene.glowing_disc(T, (0, 0.25, 1.65), 0.11, 1, (0.3, 0.23, 0.13), 5)


def pendant(scene: SceneBuilder, T: Array, ceiling: float) -> None:
    """A lamp that hangs from the ceiling."""
    metal = scene.material(pattern.PAINT, (0.2, 0.2, 0.2), contrast=0.3)
    shade = scene.material(pattern.STRIPES, (0.9, 0.78, 0.55), (0.75, 0.6, 0.4), (0.95, 0.85, 0.65), scale=0.08, contrast=0.5, glow=1.1)
    z = ceiling - 0.5
    scene.tube(T, (0, 0, z + 0.2), ceiling - z - 0.2, (0.008, 0.008), metal)
    scene.tube(T, (0, 0, ceiling - 0.03), 0.03, (0.04, 0.06), metal)
    scene.tube(T, (0, 0, z), 0.2, (0.24, 0.1), shade)
    scene.glowing_disc(T, (0, 0, z - 0.01), 0.23, -1, (5.5, 4.6, 3.4), 12)
    scene.glowing_disc(T, (0, 0, z + 0.21), 0.1, 1, (1.2, 1.0, 0.75), 4)


def plant(scene: SceneBuilder, T: Array, height: float) -> None:
    """A pot with leaves on stems."""
    rng = scene.rng
    pot = scene.material(pattern.GLAZE, (0.45, 0.2, 0.1), vivid(rng), (0.6, 0.5, 0.4))
    soil = scene.material(pattern.PAINT, (0.06, 0.035, 0.02), contrast=1.5)
    stem = scene.material(pattern.PAINT, (0.1, 0.13, 0.03), contrast=0.5)
    y = 0.3
    scene.tube(T, (0, y, 0), 0.28, (0.11, 0.16), pot)
    scene.tube(T, (0, y, 0.28), 0.005, (0.145, 0.145), soil)
    scene.tube(T, (0, y, 0.28), height - 0.55, (0.012, 0.008), stem)
    for k in range(16):
        green = scene.material(pattern.LEAVES, (0.03, 0.16, 0.03), (0.2, 0.42, 0.08), contrast=float(rng.uniform(0.7, 1.2)))
        z = 0.42 + (height - 0.65) * k / 15
        branch = T @ place(0, y, z, turn=137.5 * k) @ tilt(1, -rng.uniform(15, 55))
        length = 0.11 + 0.05 * rng.random()
        scene.ball(branch, (length + 0.02, 0, 0), (length, 0.055, 0.008), green)


def picture(scene: SceneBuilder, T: Array, x: float, z: float, width: float, height: float) -> None:
    """A framed picture on the wall, its centre at (x, z)."""
    rng, frame = scene.rng, wood(scene)
    kind = pattern.POSTER if rng.random() < 0.6 else pattern.LANDSCAPE
    art = scene.material(kind, vivid(rng, 0.15, 0.6), vivid(rng, 0.1, 0.6), vivid(rng, 0.03, 0.3))
    a, b = width / 2, height / 2
    scene.box(T, (x - a, 0, z - b), (x + a, 0.015, z + b), art)
    for low, high in (((x - a - 0.03, z + b), (x + a + 0.03, z + b + 0.03)), ((x - a - 0.03, z - b - 0.03), (x + a + 0.03, z - b))):
        scene.box(T, (low[0], 0, low[1]), (high[0], 0.03, high[1]), frame)
    for left in (x - a - 0.03, x + a):
        scene.box(T, (left, 0, z - b), (left + 0.03, 0.03, z + b), frame)


def window(scene: SceneBuilder, T: Array, width: float, low: float, high: float) -> None:
    """A view in a white frame with mullions, sill and curtains; daylight comes in through it."""
    rng, h = scene.rng, width / 2
    white = scene.material(pattern.PAINT, (0.72, 0.71, 0.68), contrast=0.15)
    view = scene.material(pattern.LANDSCAPE, (0.62, 0.74, 0.85), (0.25, 0.45, 0.8), (0.06, 0.15, 0.03), glow=1.9)
    scene.box(T, (-h, 0, low), (h, 0.01, high), view)
    for x in (-h - 0.06, -0.025, h):
        scene.box(T, (x, 0, low - 0.06), (x + (0.05 if x == -0.025 else 0.06), 0.045, high + 0.06), white)
    for z, thick in ((low - 0.06, 0.06), (low + 0.62 * (high - low), 0.04), (high, 0.06)):
        scene.box(T, (-h, 0, z), (h, 0.04, z + thick), white)
    scene.box(T, (-h - 0.1, 0, low - 0.1), (h + 0.1, 0.18, low - 0.06), white)
    curtain = cloth(scene)
    for side in (-1, 1):
        for k in range(7):
            scene.tube(T, (side * (h + 0.02 + 0.055 * k), 0.1 + 0.012 * (k % 2), 0.05), high + 0.07, (0.04, 0.033), curtain)
    rod = T @ place(0, 0.1, high + 0.15) @ tilt(1, 90)
    scene.add(FRUSTUM, rod, (0, 0, 0), (0.014, 0.014, h + 0.45), wood(scene))
    vase(scene, T, rng.uniform(-0.6, 0.6) * h, 0.1, low - 0.06, 0.2)
    n = T[:3, :3] @ np.array([0, 1.0, 0])
    for i in range(4):
        for j in range(4):
            point = T @ np.array([(2 * i - 3) / 4 * h, 0.06, low + (j + 0.5) / 4 * (high - low), 1.0])
            scene.lights.append(np.concatenate([point[:3], n, np.array([4.6, 5.2, 6.0]) * width * (high - low) / 16]))


def door(scene: SceneBuilder, T: Array, timber: int | None = None) -> None:
    """A panelled door in its frame, with a handle; of a given material, or of wood or painted."""
    seed = -1 if timber is None else 0
    if timber is None:
        timber = wood(scene) if scene.rng.random() < 0.5 else scene.material(pattern.PAINT, (0.7, 0.68, 0.62), contrast=0.2)
    scene.box(T, (-0.42, 0, 0), (0.42, 0.02, 2.03), timber)
    for x in (-0.5, 0.42):
        scene.box(T, (x, 0, 0), (x + 0.08, 0.04, 2.1), timber)
    scene.box(T, (-0.42, 0, 2.03), (0.42, 0.04, 2.1), timber)
    for low, high in ((0.15, 0.9), (1.02, 1.88)):
        for left in (-0.34, 0.04):
            scene.box(T, (left, 0.02, low), (left + 0.3, 0.032, high), timber)
    brass = scene.material(pattern.PAINT, (0.55, 0.42, 0.18), contrast=0.2, seed=seed)
    scene.box(T, (0.33, 0.02, 0.93), (0.37, 0.028, 1.1), brass)
    scene.box(T, (0.24, 0.05, 1.02), (0.36, 0.065, 1.035), brass)
    scene.ball(T, (0.35, 0.045, 1.03), (0.014, 0.03, 0.014), brass)


def clock(scene: SceneBuilder, T: Array, x: float, z: float) -> None:
    """A round clock on the wall."""
    face = T @ place(x, 0.02, z) @ tilt(0, 90)
    rim, white = wood(scene), scene.material(pattern.PAINT, (0.75, 0.73, 0.68), contrast=0.2)
    black = scene.material(pattern.PAINT, (0.03, 0.03, 0.03), contrast=0.2)
    scene.add(FRUSTUM, face, (0, 0, 0), (0.16, 0.17, 0.02), rim)
    scene.add(FRUSTUM, T @ place(x, 0.042, z) @ tilt(0, 90), (0, 0, 0), (0.14, 0.14, 0.003), white)
    for k in range(12):
        mark = T @ place(x, 0.045, z) @ tilt(1, 30 * k)
        scene.box(mark, (-0.006, 0, 0.1), (0.006, 0.003, 0.13), black)
    for turn, length in ((scene.rng.uniform(0, 360), 0.11), (scene.rng.uniform(0, 360), 0.07)):
        scene.box(T @ place(x, 0.047, z) @ tilt(1, turn), (-0.006, 0, -0.02), (0.006, 0.003, length), black)


def wall_shelf(scene: SceneBuilder, T: Array, x: float, z: float, width: float) -> None:
    """A board on the wall with books and a vase."""
    timber = wood(scene)
    scene.box(T, (x - width / 2, 0, z), (x + width / 2, 0.2, z + 0.025), timber)
    books(scene, T, x - width / 2 + 0.02, x + 0.1 * width, 0.19, z + 0.025, 0.26)
    vase(scene, T, x + 0.32 * width, 0.1, z + 0.025, 0.24)
