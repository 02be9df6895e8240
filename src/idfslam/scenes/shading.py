"""Renders a scene: exact z-depth and normals at pixel centres; colour is supersampled at the borders between surfaces.

The camera has one pose for the whole image, or a pose for each row, as while a rolling shutter reads them out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.scenes.lightmap import Lightmap, irradiance
from idfslam.scenes.procedural_textures import Colour, albedo
from idfslam.scenes.ray_casting import cast, chart_size, compiled, prune, surface_at

Array = NDArray[np.float64]
Pinhole = tuple[float, float, float, float]  # fx, fy, cx, cy [px]

_FAR = 1e3  # [m] largest depth; far larger than any scene
_TILE = 16  # [px] side of the squares that are cast together; raised, fewer hierarchies are pruned, but each is longer. Chosen by hand


@dataclass(frozen=True)
class Rendering:
    """The images of a scene from one camera."""

    colour: NDArray[np.float32]
    """(H, W, 3) RGB in [0, 1]."""
    depth: NDArray[np.float32]
    """(H, W) z-depth [m]; 0: no surface."""
    normals: NDArray[np.float32]
    """(H, W, 3) outward unit normals in the camera's frame."""


def render(shapes: Array, materials: Array, nodes: Array, lightmap: Lightmap, exposure: float, camera: Camera, T_wc: Array) -> Rendering:
    """Renders the scene from the pose `T_wc` (4, 4), or from one for each row (H, 4, 4).

    Every surface is Lambertian, so that a point has the same colour in all views.
    """
    size = (camera.height, camera.width)
    colour, depth, normals = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32), np.zeros((*size, 3), np.float32)
    labels = np.full(size, -1, np.int64)
    light = (lightmap.layout, lightmap.light, exposure)
    pinhole, poses = (camera.fx, camera.fy, camera.cx, camera.cy), _poses(T_wc, camera)
    _render(shapes, materials, nodes, *light, pinhole, poses, colour, depth, normals, labels)
    _smooth_edges(shapes, materials, nodes, *light, pinhole, poses, labels, colour)
    return Rendering(colour, depth, normals)


def render_depth(shapes: Array, nodes: Array, camera: Camera, T_wc: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Depth (H, W) and normals (H, W, 3) of `render`, without colour: several times as fast."""
    size = (camera.height, camera.width)
    depth, normals = np.zeros(size, np.float32), np.zeros((*size, 3), np.float32)
    _render_depth(shapes, nodes, (camera.fx, camera.fy, camera.cx, camera.cy), _poses(T_wc, camera), depth, normals)
    return depth, normals


def _poses(T_wc: Array, camera: Camera) -> Array:
    """(1, 4, 4) or (H, 4, 4), as the kernels take them."""
    poses = np.ascontiguousarray(T_wc, dtype=np.float64).reshape(-1, 4, 4)
    if len(poses) not in (1, camera.height):
        raise ValueError(f"{len(poses)} poses, expected one, or one for each of {camera.height} rows")
    return poses


@compiled
def _tone(x: float) -> float:
    """Tone mapping: exponential saturation, then gamma 2."""
    return np.sqrt(1.0 - np.exp(-max(x, 0.0)))


@compiled
def _ray(pinhole: Pinhole, T: Array, u: float, v: float) -> Colour:
    """The ray direction in the world through a pixel; z = 1 in the camera's frame."""
    x, y = (u - pinhole[2]) / pinhole[0], (v - pinhole[3]) / pinhole[1]
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2],
        T[1, 0] * x + T[1, 1] * y + T[1, 2],
        T[2, 0] * x + T[2, 1] * y + T[2, 2],
    )


@compiled
def _tiles(rows: int, columns: int) -> int:
    """The number of tiles that cover the image."""
    return -(-rows // _TILE) * -(-columns // _TILE)


@compiled
def _corner(tile: int, columns: int) -> tuple[int, int]:
    """First row and column of a tile."""
    across = -(-columns // _TILE)
    return tile // across * _TILE, tile % across * _TILE


@compiled
def _pose(poses: Array, row: int) -> Array:
    """The pose (4, 4) of a row, of one for the whole image (1, 4, 4) or one for each row (H, 4, 4)."""
    return poses[row if poses.shape[0] > 1 else 0]


@compiled
def _prune(nodes: Array, pinhole: Pinhole, poses: Array, left: int, top: int, leaves: Array) -> int:
    """Writes the leaves that rays through a tile, up to the outer edges of its pixels, can hit to `leaves`; returns their number.

    A tile is one band if it has one pose, else each row is one.
    """
    bands, height = (min(_TILE, poses.shape[0] - top), 1) if poses.shape[0] > 1 else (1, _TILE)
    first, corners = top if poses.shape[0] > 1 else 0, np.empty((bands, 4, 3))
    for band in range(bands):
        T, y = poses[first + band], top + band * height
        for k, (right, down) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
            ray = _ray(pinhole, T, left + right * _TILE - 0.5, y + down * height - 0.5)
            corners[band, k, 0], corners[band, k, 1], corners[band, k, 2] = ray
    return prune(nodes, poses[first : first + bands], corners, leaves)


@compiled
def _shade(
    shapes: Array, materials: Array, layout: NDArray[np.int64], light: NDArray[np.float32], exposure: float,
    T: Array, d: Colour, t: float, shape: int, pixel: float,
) -> tuple[float, float, float, int, float, float, float]:  # fmt: skip
    """Colour, chart and normal (world) where a ray hits a shape; `pixel` is the width of a pixel at depth 1."""
    chart, s, r, nx, ny, nz = surface_at(shapes, shape, T[0, 3] + t * d[0], T[1, 3] + t * d[1], T[2, 3] + t * d[2])
    su, sv = chart_size(shapes, shape, chart)
    cosine = abs(nx * d[0] + ny * d[1] + nz * d[2]) / np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
    cosine = max(cosine, 0.1)
    width = t * pixel / np.sqrt(cosine * np.sqrt(cosine))  # between the short and the long side of the pixel's footprint on the surface
    m = int(shapes[shape, 16])
    seed = materials[m, 13] if materials[m, 13] >= 0 else 8.0 * shape + chart
    a = albedo(materials, m, chart, s, r, su, sv, seed, width)
    e = irradiance(layout, light, shape, chart, s, r)
    red, green, blue = (
        a[0] * (e[0] * exposure + materials[m, 3]),
        a[1] * (e[1] * exposure + materials[m, 3]),
        a[2] * (e[2] * exposure + materials[m, 3]),
    )
    return _tone(red), _tone(green), _tone(blue), chart, nx, ny, nz


@compiled
def _render(
    shapes: Array, materials: Array, nodes: Array, layout: NDArray[np.int64], light: NDArray[np.float32], exposure: float,
    pinhole: Pinhole, poses: Array, colour: NDArray[np.float32], depth: NDArray[np.float32],
    normals: NDArray[np.float32], labels: NDArray[np.int64],
) -> None:  # fmt: skip
    rows, columns = depth.shape
    leaves = np.empty_like(nodes)
    for tile in range(_tiles(rows, columns)):
        top, left = _corner(tile, columns)
        count, shape = _prune(nodes, pinhole, poses, left, top, leaves), -1
        for v in range(top, min(top + _TILE, rows)):
            T = _pose(poses, v)
            for u in range(left, min(left + _TILE, columns)):
                d = _ray(pinhole, T, float(u), float(v))
                t, shape = cast(shapes, leaves[:count], T[0, 3], T[1, 3], T[2, 3], d[0], d[1], d[2], _FAR, shape)
                if shape < 0:
                    continue
                red, green, blue, chart, nx, ny, nz = _shade(shapes, materials, layout, light, exposure, T, d, t, shape, 1.0 / pinhole[0])
                depth[v, u], labels[v, u] = t, shape * 8 + chart
                colour[v, u, 0], colour[v, u, 1], colour[v, u, 2] = red, green, blue
                for k in range(3):
                    normals[v, u, k] = T[0, k] * nx + T[1, k] * ny + T[2, k] * nz


@compiled
def _render_depth(
    shapes: Array, nodes: Array, pinhole: Pinhole, poses: Array, depth: NDArray[np.float32], normals: NDArray[np.float32]
) -> None:  # fmt: skip
    rows, columns = depth.shape
    leaves = np.empty_like(nodes)
    for tile in range(_tiles(rows, columns)):
        top, left = _corner(tile, columns)
        count, shape = _prune(nodes, pinhole, poses, left, top, leaves), -1
        for v in range(top, min(top + _TILE, rows)):
            T = _pose(poses, v)
            for u in range(left, min(left + _TILE, columns)):
                d = _ray(pinhole, T, float(u), float(v))
                t, shape = cast(shapes, leaves[:count], T[0, 3], T[1, 3], T[2, 3], d[0], d[1], d[2], _FAR, shape)
                if shape < 0:
                    continue
                _, _, _, nx, ny, nz = surface_at(shapes, shape, T[0, 3] + t * d[0], T[1, 3] + t * d[1], T[2, 3] + t * d[2])
                depth[v, u] = t
                for k in range(3):
                    normals[v, u, k] = T[0, k] * nx + T[1, k] * ny + T[2, k] * nz


@compiled
def _smooth_edges(
    shapes: Array, materials: Array, nodes: Array, layout: NDArray[np.int64], light: NDArray[np.float32], exposure: float,
    pinhole: Pinhole, poses: Array, labels: NDArray[np.int64], colour: NDArray[np.float32],
) -> None:  # fmt: skip
    """Replaces the colour of pixels whose neighbours show another surface by the mean of 2 x 2 rays."""
    rows, columns = labels.shape
    leaves = np.empty_like(nodes)
    for tile in range(_tiles(rows, columns)):
        top, left = _corner(tile, columns)
        count = _prune(nodes, pinhole, poses, left, top, leaves)
        for v in range(top, min(top + _TILE, rows)):
            T = _pose(poses, v)
            for u in range(left, min(left + _TILE, columns)):
                here = labels[v, u]
                same = labels[max(v - 1, 0), u] == here and labels[min(v + 1, rows - 1), u] == here
                if same and labels[v, max(u - 1, 0)] == here and labels[v, min(u + 1, columns - 1)] == here:
                    continue
                red, green, blue = 0.0, 0.0, 0.0
                for k in range(4):
                    d = _ray(pinhole, T, u + 0.5 * (k % 2) - 0.25, v + 0.5 * (k // 2) - 0.25)
                    t, shape = cast(shapes, leaves[:count], T[0, 3], T[1, 3], T[2, 3], d[0], d[1], d[2], _FAR, here // 8)
                    if shape >= 0:
                        r, g, b, _, _, _, _ = _shade(shapes, materials, layout, light, exposure, T, d, t, shape, 0.7 / pinhole[0])
                        red, green, blue = red + r / 4, green + g / 4, blue + b / 4
                colour[v, u, 0], colour[v, u, 1], colour[v, u, 2] = red, green, blue
