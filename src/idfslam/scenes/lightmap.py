"""Light baked into textures (radiosity): soft shadows, and coloured light that surfaces reflect onto each other.

Every surface is Lambertian, so that baked light is valid for every view. The textures hold irradiance at texels on the shapes' charts:
direct light from area lights, given as point samples, and one bounce gathered over the hemisphere.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.scenes.procedural_textures import Colour, random
from idfslam.scenes.ray_casting import CHARTS, cast, chart_size, compiled, point_on, surface_at

Array = NDArray[np.float64]

_TEXEL = 0.05  # [m] side of a texel; raised, shadows are coarser and baking is faster. Chosen by hand
_OFFSET = 1e-4  # [m] distance of a ray's start from the surface; raised, light leaks at contacts; lowered, surfaces shadow themselves
_RAYS = 36  # rays of a bounce over the hemisphere; raised, bounced light has less noise and baking is slower. Chosen by hand


@dataclass(frozen=True)
class Lightmap:
    """Irradiance of all charts."""

    layout: NDArray[np.int64]
    """(P, 6, 3) offset, columns and rows of each shape's charts in `light`."""
    light: NDArray[np.float32]
    """(T, 3) irradiance, row after row, chart after chart."""


def bake(shapes: Array, materials: Array, nodes: Array, lights: Array) -> Lightmap:
    """Bakes the light of `lights` (L, 9) on `shapes` (P, 17). A light is position [m], normal (zero: shines to all sides), power (RGB)."""
    layout = layout_of(shapes)
    direct = np.zeros((int(layout[-1, -1, 0] + layout[-1, -1, 1] * layout[-1, -1, 2]), 3))
    bounced = np.zeros_like(direct)
    seen = np.zeros(len(direct), np.bool_)
    _bake_direct(shapes, nodes, layout, lights, direct, seen)
    direct = _blurred(layout, direct, seen)
    _gather(shapes, materials, nodes, layout, direct.astype(np.float32), bounced)
    return Lightmap(layout, (direct + _blurred(layout, _blurred(layout, bounced, seen), seen)).astype(np.float32))


def layout_of(shapes: Array) -> NDArray[np.int64]:
    """The `Lightmap.layout` of shapes (P, 17)."""
    layout = np.zeros((len(shapes), CHARTS, 3), np.int64)
    offset = 0
    for p in range(len(shapes)):
        for chart in range(CHARTS):
            su, sv = chart_size(shapes, p, chart)
            columns, rows = (max(2, round(su / _TEXEL)), max(2, round(sv / _TEXEL))) if su > 0 else (0, 0)
            layout[p, chart] = offset, columns, rows
            offset += columns * rows
    return layout


def normals(shapes: Array, layout: NDArray[np.int64]) -> Array:
    """(T, 3) the outward normals at the middles of all texels."""
    out = np.zeros((int(layout[-1, -1, 0] + layout[-1, -1, 1] * layout[-1, -1, 2]), 3))
    _normals(shapes, layout, out)
    return out


@compiled
def _normals(shapes: Array, layout: NDArray[np.int64], out: Array) -> None:
    for shape in range(shapes.shape[0]):
        for chart in range(CHARTS):
            offset, columns, rows = layout[shape, chart]
            for k in range(columns * rows):
                x, y, z = point_on(shapes, shape, chart, (k % columns + 0.5) / columns, (k // columns + 0.5) / rows)
                _, _, _, out[offset + k, 0], out[offset + k, 1], out[offset + k, 2] = surface_at(shapes, shape, x, y, z)


def _blurred(layout: NDArray[np.int64], light: Array, seen: NDArray[np.bool_]) -> Array:
    """Applies a 3 x 3 box filter within each chart against sampling noise; texels inside a shape get the light of their neighbours."""
    out = light.copy()
    for offset, columns, rows in layout.reshape(-1, 3).tolist():
        part = slice(offset, offset + columns * rows)
        if columns * rows == 0 or not seen[part].any():
            continue
        weight = seen[part].reshape(rows, columns).astype(np.float64)
        image = cv2.blur(light[part].reshape(rows, columns, 3) * weight[..., None], (3, 3), borderType=cv2.BORDER_CONSTANT)
        share = cv2.blur(weight, (3, 3), borderType=cv2.BORDER_CONSTANT)
        empty = share < 1e-6
        image = image / np.maximum(share, 1e-6)[..., None]
        image[empty] = light[part][seen[part]].mean(0)
        out[part] = image.reshape(-1, 3)
    return out


@compiled
def irradiance(layout: NDArray[np.int64], light: NDArray[np.float32], shape: int, chart: int, s: float, t: float) -> Colour:
    """The irradiance (RGB) at (s, t) of a chart, by bilinear interpolation."""
    offset, columns, rows = layout[shape, chart]
    x, y = min(max(s * columns - 0.5, 0.0), columns - 1.0), min(max(t * rows - 0.5, 0.0), rows - 1.0)
    i, j = min(int(x), columns - 2), min(int(y), rows - 2)
    a, b, k = x - i, y - j, offset + j * columns + i
    p, q, r, z = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    return (
        p * light[k, 0] + q * light[k + 1, 0] + r * light[k + columns, 0] + z * light[k + columns + 1, 0],
        p * light[k, 1] + q * light[k + 1, 1] + r * light[k + columns, 1] + z * light[k + columns + 1, 1],
        p * light[k, 2] + q * light[k + 1, 2] + r * light[k + columns, 2] + z * light[k + columns + 1, 2],
    )


@compiled
def _direct(shapes: Array, nodes: Array, lights: Array, p: Array, n: Array, out: Array) -> None:
    """Adds to `out` the light of all samples at a point p with normal n."""
    for k in range(lights.shape[0]):
        d = lights[k, :3] - p
        square = d @ d
        facing = n @ d
        if facing <= 0:
            continue
        leaving = -(lights[k, 3:6] @ d)
        omni = lights[k, 3] == 0 and lights[k, 4] == 0 and lights[k, 5] == 0
        if not omni and leaving <= 0:
            continue
        form = facing / square**1.5 * (1.0 if omni else leaving / np.sqrt(square))
        start = p + _OFFSET * n
        _, shape = cast(shapes, nodes, start[0], start[1], start[2], d[0], d[1], d[2], 1.0 - 1e-3, -1)
        if shape < 0:
            out += lights[k, 6:9] * form


@compiled
def _texel(shapes: Array, nodes: Array, layout: NDArray[np.int64], shape: int, chart: int, k: int, p: Array, n: Array) -> bool:
    """Sets point p and normal n for texel k of a chart: its middle, or near a corner if that is inside another shape; False: all are."""
    _, columns, rows = layout[shape, chart]
    for x, y in ((0.5, 0.5), (0.06, 0.06), (0.94, 0.06), (0.06, 0.94), (0.94, 0.94)):
        s, t = (k % columns + x) / columns, (k // columns + y) / rows
        p[0], p[1], p[2] = point_on(shapes, shape, chart, s, t)
        _, _, _, n[0], n[1], n[2] = surface_at(shapes, shape, p[0], p[1], p[2])
        if not _buried(shapes, nodes, p, n):
            return True
    return False


@compiled
def _buried(shapes: Array, nodes: Array, p: Array, n: Array) -> bool:
    """Whether a point is inside another shape: a ray along the normal leaves a shape before it enters one."""
    q = p + _OFFSET * n
    length, hit = cast(shapes, nodes, q[0], q[1], q[2], n[0], n[1], n[2], 50.0, -1)
    if hit < 0:
        return False
    q += length * n
    _, _, _, x, y, z = surface_at(shapes, hit, q[0], q[1], q[2])
    return x * n[0] + y * n[1] + z * n[2] > 0


@compiled
def _bake_direct(shapes: Array, nodes: Array, layout: NDArray[np.int64], lights: Array, light: Array, seen: NDArray[np.bool_]) -> None:
    """Bakes the direct light of all texels; sets in `seen` which of them are not inside another shape."""
    p, n = np.empty(3), np.empty(3)
    for shape in range(shapes.shape[0]):
        for chart in range(CHARTS):
            offset, columns, rows = layout[shape, chart]
            for k in range(columns * rows):
                seen[offset + k] = _texel(shapes, nodes, layout, shape, chart, k, p, n)
                if seen[offset + k]:
                    _direct(shapes, nodes, lights, p, n, light[offset + k])


@compiled
def _gather(shapes: Array, materials: Array, nodes: Array, layout: NDArray[np.int64], direct: NDArray[np.float32], light: Array) -> None:
    """Adds one bounce: the light that surfaces reflect, gathered by cosine-weighted rays."""
    p, n, x, y = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for shape in range(shapes.shape[0]):
        for chart in range(CHARTS):
            offset, columns, rows = layout[shape, chart]
            for k in range(columns * rows):
                if not _texel(shapes, nodes, layout, shape, chart, k, p, n):
                    continue
                helper = 1.0 if abs(n[2]) < 0.9 else 0.0
                x[0], x[1], x[2] = -n[1] * helper, n[0] * helper - n[2] * (1 - helper), n[1] * (1 - helper)
                x /= np.sqrt(x @ x)
                y[0], y[1], y[2] = n[1] * x[2] - n[2] * x[1], n[2] * x[0] - n[0] * x[2], n[0] * x[1] - n[1] * x[0]
                _bounce(shapes, materials, nodes, layout, direct, p + _OFFSET * n, n, x, y, offset + k, light[offset + k])


@compiled
def _bounce(
    shapes: Array, materials: Array, nodes: Array, layout: NDArray[np.int64], direct: NDArray[np.float32],
    p: Array, n: Array, x: Array, y: Array, seed: int, out: Array,
) -> None:  # fmt: skip
    """Adds to `out` the mean over a stratified hemisphere of rays from p."""
    shift, turn = random(seed, 1, 5), 2 * np.pi * random(seed, 2, 5)
    for i in range(_RAYS):
        square = (i + shift) / _RAYS
        phi = turn + i * 2.39996  # the golden angle
        r = np.sqrt(square)
        d = x * (r * np.cos(phi)) + y * (r * np.sin(phi)) + n * np.sqrt(1 - square)
        length, shape = cast(shapes, nodes, p[0], p[1], p[2], d[0], d[1], d[2], 50.0, -1)
        if shape < 0:
            continue
        hit = p + length * d
        chart, s, t, nx, ny, nz = surface_at(shapes, shape, hit[0], hit[1], hit[2])
        m = int(shapes[shape, 16])
        if nx * d[0] + ny * d[1] + nz * d[2] < 0:
            red, green, blue = irradiance(layout, direct, shape, chart, s, t)
            out[0] += (red * (materials[m, 4] + materials[m, 7]) / 2 + materials[m, 3] * materials[m, 4]) / _RAYS
            out[1] += (green * (materials[m, 5] + materials[m, 8]) / 2 + materials[m, 3] * materials[m, 5]) / _RAYS
            out[2] += (blue * (materials[m, 6] + materials[m, 9]) / 2 + materials[m, 3] * materials[m, 6]) / _RAYS
