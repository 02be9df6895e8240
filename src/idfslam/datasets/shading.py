"""Images of a scene: exact z-depth and normals at the pixel centres, colour supersampled where surfaces meet."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from idfslam.datasets.lightmap import Lightmap, irradiance
from idfslam.datasets.procedural_textures import Colour, albedo
from idfslam.datasets.ray_casting import Hierarchy, cast, chart_size, surface_at
from idfslam.geometry.camera import Camera

Array = NDArray[np.float64]

_FAR = 1e3  # [m]


@dataclass(frozen=True)
class Rendering:
    """What a camera sees of a scene."""

    colour: NDArray[np.float32]
    """(H, W, 3) RGB in [0, 1]."""
    depth: NDArray[np.float32]
    """(H, W) z-depth [m]; 0: nothing there."""
    normals: NDArray[np.float32]
    """(H, W, 3) outward unit normals in the camera's frame."""


def render(shapes: Array, materials: Array, tree: Hierarchy, lightmap: Lightmap, exposure: float, camera: Camera, T_wc: Array) -> Rendering:
    """The scene from the pose `T_wc` (4, 4); every surface is Lambertian, so a point has one colour in all views."""
    size = (camera.height, camera.width)
    colour, depth, normals = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32), np.zeros((*size, 3), np.float32)
    labels = np.full(size, -1, np.int64)
    scene = (shapes, materials, (tree.bounds, tree.skip, tree.first, tree.count, tree.order), lightmap.layout, lightmap.light, exposure)
    pinhole = (camera.fx, camera.fy, camera.cx, camera.cy)
    T_wc = np.ascontiguousarray(T_wc, dtype=np.float64)
    _render(scene, pinhole, T_wc, colour, depth, normals, labels)
    _smooth_edges(scene, pinhole, T_wc, labels, colour)
    return Rendering(colour, depth, normals)


@njit(cache=True, nogil=True)
def _tone(x: float) -> float:
    """Film: exponential saturation, then gamma 2."""
    return np.sqrt(1.0 - np.exp(-x))


@njit(cache=True, nogil=True)
def _ray(pinhole: tuple[float, float, float, float], T: Array, u: float, v: float) -> Colour:
    """Direction in the world with z = 1 in the camera."""
    x, y = (u - pinhole[2]) / pinhole[0], (v - pinhole[3]) / pinhole[1]
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2],
        T[1, 0] * x + T[1, 1] * y + T[1, 2],
        T[2, 0] * x + T[2, 1] * y + T[2, 2],
    )


@njit(cache=True, nogil=True)
def _shade(scene: tuple, T: Array, d: Colour, t: float, shape: int, pixel: float) -> tuple:
    """Colour, chart and normal (world) where a ray meets a shape; `pixel` is a pixel's width at depth 1."""
    shapes, materials, _, layout, light, exposure = scene
    chart, s, r, nx, ny, nz = surface_at(shapes[shape], T[0, 3] + t * d[0], T[1, 3] + t * d[1], T[2, 3] + t * d[2])
    su, sv = chart_size(shapes[shape], chart)
    cosine = abs(nx * d[0] + ny * d[1] + nz * d[2]) / np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
    width = t * pixel / max(cosine, 0.1) ** 0.7
    material = materials[int(shapes[shape, 16])]
    a = albedo(material, chart, s, r, su, sv, 8.0 * shape + chart, width)
    e = irradiance(layout, light, shape, chart, s, r)
    red, green, blue = a[0] * (e[0] * exposure + material[3]), a[1] * (e[1] * exposure + material[3]), a[2] * (e[2] * exposure + material[3])
    return _tone(red), _tone(green), _tone(blue), chart, nx, ny, nz


@njit(cache=True, nogil=True)
def _render(
    scene: tuple, pinhole: tuple[float, float, float, float], T: Array, colour: Array, depth: Array, normals: Array, labels: NDArray[np.int64]
) -> None:
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            d = _ray(pinhole, T, u, v)
            t, shape = cast(scene[0], scene[2], T[0, 3], T[1, 3], T[2, 3], d[0], d[1], d[2], _FAR)
            if shape < 0:
                continue
            red, green, blue, chart, nx, ny, nz = _shade(scene, T, d, t, shape, 1.0 / pinhole[0])
            depth[v, u], labels[v, u] = t, shape * 8 + chart
            colour[v, u, 0], colour[v, u, 1], colour[v, u, 2] = red, green, blue
            for k in range(3):
                normals[v, u, k] = T[0, k] * nx + T[1, k] * ny + T[2, k] * nz


@njit(cache=True, nogil=True)
def _smooth_edges(scene: tuple, pinhole: tuple[float, float, float, float], T: Array, labels: NDArray[np.int64], colour: Array) -> None:
    """Where a neighbour shows another surface, the mean of 2 x 2 rays stands for the pixel."""
    rows, columns = labels.shape
    for v in range(rows):
        for u in range(columns):
            here = labels[v, u]
            same = labels[max(v - 1, 0), u] == here and labels[min(v + 1, rows - 1), u] == here
            if same and labels[v, max(u - 1, 0)] == here and labels[v, min(u + 1, columns - 1)] == here:
                continue
            red, green, blue = 0.0, 0.0, 0.0
            for k in range(4):
                d = _ray(pinhole, T, u + 0.5 * (k % 2) - 0.25, v + 0.5 * (k // 2) - 0.25)
                t, shape = cast(scene[0], scene[2], T[0, 3], T[1, 3], T[2, 3], d[0], d[1], d[2], _FAR)
                if shape >= 0:
                    r, g, b, _, _, _, _ = _shade(scene, T, d, t, shape, 0.7 / pinhole[0])
                    red, green, blue = red + r / 4, green + g / 4, blue + b / 4
            colour[v, u, 0], colour[v, u, 1], colour[v, u, 2] = red, green, blue
