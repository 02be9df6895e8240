"""A mesh with a texture instead of vertex colours: an atlas of one patch a triangle, filled from images or from the map.

Two triangles share a square of texels, mirrored; one texel around each of them continues its plane, so that bilinear sampling within a
triangle never meets a neighbour's colour. Squares follow the order of the triangles, which is that of the blocks of space: where coarser
mip levels do mix neighbours, they are neighbours in the room.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import trimesh
from numba import njit, prange
from numpy.typing import NDArray
from PIL import Image

from idfslam.errors import ConfigError
from idfslam.frame import Frame

_SQUARE = 8  # texels along the edge of a square
_LEG = _SQUARE - 3  # texels along a triangle's leg
_LARGEST = 16384  # texels along the edge of an atlas that graphics cards take
_SHARPNESS = 4  # how much the better of two views counts: their weights to this power
_NEAR = 0.02  # share of the depth, and metres, by which a measured depth may differ from the surface's own

Floats = NDArray[np.float32]
Shade = Callable[[Floats, Floats], Floats]  # points (N, 3) [m], unit normals (N, 3) -> RGB (N, 3) in [0, 1]


@dataclass(frozen=True, eq=False)
class Atlas:
    """Where the texels and corners of F triangles lie in a square image of `size` texels."""

    size: int
    barycentric: Floats  # (K, 3) of the texels of every triangle
    columns: NDArray[np.int32]  # (F, K)
    rows: NDArray[np.int32]  # (F, K)
    uv: NDArray[np.float64]  # (F, 3, 2) in [0, 1], v upwards


def atlas(faces: int) -> Atlas:
    """For so many triangles. Raises ConfigError where they are too many."""
    across = int(np.ceil(np.sqrt(max(1, -(-faces // 2)))))
    size = across * _SQUARE
    if size > _LARGEST:
        raise ConfigError(f"a texture of {faces} triangles would be {size} texels wide, at most {_LARGEST}; choose a larger --resolution")
    j, i = np.mgrid[0 : _LEG + 2, 0 : _LEG + 2].reshape(2, -1)
    texels = np.stack([i, j], -1)[i + j <= _LEG + 1]
    corners = np.array([[0, 0], [_LEG, 0], [0, _LEG]])
    b = texels / np.float32(_LEG)
    face = np.arange(faces)
    square, mirrored = face // 2, (face % 2 == 1)[:, None, None]
    origin = np.stack([square % across, square // across], -1)[:, None] * _SQUARE

    def placed(local: NDArray[np.int64]) -> NDArray[np.int64]:
        return origin + np.where(mirrored, _SQUARE - 1 - local, local)

    place = placed(texels).astype(np.int32)
    uv = (placed(corners) + 0.5) / size
    uv[..., 1] = 1 - uv[..., 1]
    barycentric = np.concatenate([1 - b.sum(-1, keepdims=True), b], -1).astype(np.float32)
    return Atlas(size, barycentric, place[..., 0], place[..., 1], uv)


def textured(mesh: trimesh.Trimesh, shade: Shade) -> trimesh.Trimesh:
    """The mesh with three vertices a triangle and an atlas whose texels are coloured by `shade`."""
    layout = atlas(len(mesh.faces))
    corners = np.asarray(mesh.triangles, np.float32)
    normals = np.repeat(np.asarray(mesh.face_normals, np.float32), len(layout.barycentric), 0)
    colours = shade((layout.barycentric @ corners).reshape(-1, 3), normals)
    image = np.zeros((layout.size, layout.size, 3), np.uint8)
    image[layout.rows.ravel(), layout.columns.ravel()] = np.round(np.clip(colours, 0, 1) * 255).astype(np.uint8)
    options = {"metallicFactor": 0.0, "roughnessFactor": 1.0, "doubleSided": True}
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(image), **options)
    visual = trimesh.visual.TextureVisuals(layout.uv.reshape(-1, 2), material=material)
    return trimesh.Trimesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), visual=visual, process=False)


def from_images(frames: Iterable[tuple[Frame, NDArray[np.float64]]], otherwise: Shade) -> Shade:
    """Colours from the frames, with their T_wc (4, 4), that see a point nearest and straightest; `otherwise` where none sees it."""

    def shade(points: Floats, normals: Floats) -> Floats:
        colours, weights = np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
        for frame, T_wc in frames:
            c = frame.camera
            pose = np.linalg.inv(T_wc).astype(np.float32), T_wc[:3, 3].astype(np.float32)
            intrinsics = tuple(np.float32(x) for x in (c.fx, c.fy, c.cx, c.cy))
            _gather(points, normals, *pose, intrinsics, frame.colour, frame.depth, colours, weights)
        seen = weights > 0
        colours[seen] /= weights[seen, None]
        if not seen.all():
            colours[~seen] = otherwise(points[~seen], normals[~seen])
        return colours

    return shade


@njit(parallel=True, cache=True, fastmath=True)
def _gather(points, normals, T_cw, centre, intrinsics, image, depth, colours, weights):  # type: ignore[no-untyped-def]
    """Adds what one image shows of points (N, 3) to `colours` (N, 3) and `weights` (N,)."""
    fx, fy, cx, cy = intrinsics
    height, width = depth.shape
    for i in prange(len(points)):
        x, y, z = points[i]
        z_c = T_cw[2, 0] * x + T_cw[2, 1] * y + T_cw[2, 2] * z + T_cw[2, 3]
        if z_c <= 0.05:
            continue
        u = (T_cw[0, 0] * x + T_cw[0, 1] * y + T_cw[0, 2] * z + T_cw[0, 3]) / z_c * fx + cx
        v = (T_cw[1, 0] * x + T_cw[1, 1] * y + T_cw[1, 2] * z + T_cw[1, 3]) / z_c * fy + cy
        if not (0 <= u < width - 1 and 0 <= v < height - 1):
            continue
        measured = depth[int(v + 0.5), int(u + 0.5)]
        if not (measured > 0 and abs(measured - z_c) < _NEAR * (1 + z_c)):
            continue
        dx, dy, dz = centre[0] - x, centre[1] - y, centre[2] - z
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        cosine = (dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]) / distance
        border = min(u, v, width - 1 - u, height - 1 - v) / (0.1 * width)  # towards an image's border it fades out: no seam there
        if cosine <= 0.05 or border <= 0:
            continue
        weight = (cosine / distance) ** _SHARPNESS * min(border, 1.0)
        column, row = int(u), int(v)
        a, b = u - column, v - row
        for channel in range(3):
            top = image[row, column, channel] * (1 - a) + image[row, column + 1, channel] * a
            bottom = image[row + 1, column, channel] * (1 - a) + image[row + 1, column + 1, channel] * a
            colours[i, channel] += weight * (top * (1 - b) + bottom * b)
        weights[i] += weight
