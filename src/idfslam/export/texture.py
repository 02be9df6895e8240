"""Gives a mesh a texture instead of vertex colours. The texture is an atlas with one patch per triangle, filled from images or the map.

Two triangles share a square of texels, the second one mirrored. A square has 8, 16, 32 ... texels along its edge, as its triangles need,
to the nearest power of two. A margin of one texel around each triangle continues its plane, so that bilinear sampling inside a triangle
never mixes in another triangle's colour. The squares lie along a Morton curve, the largest first, so they leave no gaps. Those of one size
are in the order of their triangles along a Morton curve in space: coarse mip levels mix neighbouring squares, so these are neighbours in
the room as well.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from idfslam.errors import ConfigError
from idfslam.views.blending import Floats
from idfslam.views.surface_colour import Shade

_SMALLEST, _WIDEST = 8, 512  # texels along the edge of a square. Smallest raised: small triangles are sharper, and the texture is larger
_MARGIN = 3  # texels of a square beside a triangle's leg; fewer, the two triangles of a square would touch
_LARGEST = 16384  # texels along the edge of an atlas; larger ones exceed the limit of common graphics cards
FINEST = 0.002  # [m] edge of a texel: a pixel of 640 x 480 at a distance of 1 m. Larger: a smaller, softer texture
_MOST = 12_000_000  # texels at most. More: sharper large rooms, more time (36 ns a texel and image), larger files. Chosen by hand
_USED = 0.2  # [1] share of the texels that lies inside of triangles, as measured on rooms: squares are wider than their triangles


@dataclass(frozen=True, eq=False)
class Atlas:
    """The positions of the texels and corners of F triangles in an image of `width` x `height` texels."""

    width: int
    height: int
    face: NDArray[np.int64]  # (T,) the triangle of each texel
    barycentric: Floats  # (T, 3) of the texels, by the corners of their triangles
    column: NDArray[np.int64]  # (T,)
    row: NDArray[np.int64]  # (T,)
    uv: NDArray[np.float64]  # (F, 3, 2) in [0, 1], v upwards


def texel_size(area: float, most: int = _MOST) -> float:
    """The edge [m] of the texels of a surface [m2] so that an atlas has about `most` of them, or FINEST if that is larger."""
    return max(FINEST, float(np.sqrt(area / (most * _USED))))


def atlas(triangles: Floats, texel: float) -> Atlas:
    """The atlas of triangles (F, 3, 3) [m] whose texels have the edge `texel` [m]. Raises ConfigError if it would be too large."""
    legs = np.linalg.norm(np.roll(triangles, -1, 1) - np.roll(triangles, -2, 1), axis=-1)  # opposite each corner
    right = legs.argmax(1)  # the corner that is mapped to a right angle: it has the widest one
    order = (right[:, None] + np.arange(3)) % 3
    longest = np.take_along_axis(legs, order[:, 1:], 1).max(1) / texel
    edge = np.clip(2 ** np.round(np.log2(longest + _MARGIN)), _SMALLEST, _WIDEST).astype(np.int64)
    sizes = np.unique(edge)[::-1]
    along = _along_curve(triangles.mean(1))
    faces = [along[edge[along] == size] for size in sizes]
    cells = [(-(-len(of_size) // 2)) * (size // _SMALLEST) ** 2 for of_size, size in zip(faces, sizes)]
    x, y = _morton(np.arange(sum(cells)))
    width, height = (int(part.max(initial=0) + 1) * _SMALLEST for part in (x, y))
    if max(width, height) > _LARGEST:
        found = f"a texture of {len(triangles)} triangles would be {max(width, height)} texels wide"
        raise ConfigError(f"{found}, at most {_LARGEST}; choose a larger --resolution")
    uv, parts, first = np.empty((len(triangles), 3, 2)), [], 0
    for of_size, size, taken in zip(faces, sizes, cells):
        start = first + np.arange(len(of_size)) // 2 * (size // _SMALLEST) ** 2
        first += taken
        origin = np.stack([x[start], y[start]], -1)[:, None] * _SMALLEST
        mirrored = (np.arange(len(of_size)) % 2 == 1)[:, None, None]
        leg = size - _MARGIN
        j, i = np.mgrid[0:size, 0:size].reshape(2, -1)
        inside = i + j < size
        local = np.stack([i, j], -1)[inside]
        place = origin + np.where(mirrored, size - 1 - local, local)
        b = local / np.float32(leg)
        ordered = np.concatenate([1 - b.sum(-1, keepdims=True), b], -1).astype(np.float32)
        parts.append((of_size, np.take(ordered, np.argsort(order[of_size], 1), 1), place))
        corners = np.array([[0, 0], [leg, 0], [0, leg]])
        at = (origin + np.where(mirrored, size - 1 - corners, corners) + 0.5) / (width, height)
        uv[of_size[:, None], order[of_size]] = np.stack([at[..., 0], 1 - at[..., 1]], -1)
    face = np.concatenate([np.repeat(of_size, place.shape[1]) for of_size, _, place in parts])
    barycentric = np.concatenate([np.swapaxes(b, 0, 1).reshape(-1, 3) for _, b, _ in parts])
    column, row = np.concatenate([place.reshape(-1, 2) for _, _, place in parts]).T
    return Atlas(width, height, face, barycentric, column, row, uv)


def _morton(code: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The column and row of places along a Morton curve: their even and odd bits."""

    def even(bits: NDArray[np.int64]) -> NDArray[np.int64]:
        bits = bits & 0x55555555
        for shift, mask in ((1, 0x33333333), (2, 0x0F0F0F0F), (4, 0x00FF00FF), (8, 0x0000FFFF)):
            bits = (bits | bits >> shift) & mask
        return bits

    return even(code), even(code >> 1)


def _along_curve(points: Floats) -> NDArray[np.int64]:
    """The order of points (N, 3) along a Morton curve."""
    low, high = points.min(0, initial=np.inf), points.max(0, initial=-np.inf)
    cell = ((points - low) / max(float((high - low).max(initial=0)), 1e-9) * 1023).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= (cell[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def textured(mesh: trimesh.Trimesh, shade: Shade, texel: float | None = None) -> trimesh.Trimesh:
    """The mesh with three vertices a triangle and an atlas whose texels, with the edge `texel` [m], are coloured by `shade`."""
    corners = np.asarray(mesh.triangles, np.float32)
    layout = atlas(corners, texel_size(mesh.area) if texel is None else texel)
    points = np.einsum("tc,tcx->tx", layout.barycentric, corners[layout.face], dtype=np.float32)
    smooth = np.asarray(mesh.vertex_normals, np.float32)[mesh.faces]  # those of thin triangles themselves are hardly known
    normals = np.einsum("tc,tcx->tx", np.clip(layout.barycentric, 0, 1), smooth[layout.face], dtype=np.float32)
    colours = shade(points, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6))
    image = np.zeros((layout.height, layout.width, 3), np.uint8)
    image[layout.row, layout.column] = np.round(np.clip(colours, 0, 1) * 255).astype(np.uint8)
    options = {"metallicFactor": 0.0, "roughnessFactor": 1.0, "doubleSided": True}
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(image), **options)
    visual = trimesh.visual.TextureVisuals(layout.uv.reshape(-1, 2), material=material)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return trimesh.Trimesh(corners.reshape(-1, 3), faces, vertex_normals=smooth.reshape(-1, 3), visual=visual, process=False)
