"""Gives a mesh a texture instead of vertex colours. The texture is an atlas with one patch per triangle, filled from images or the map.

Two triangles share a square of texels, the second one mirrored. A margin of one texel around each triangle continues its plane, so that
bilinear sampling inside a triangle never mixes in another triangle's colour. The squares are in the order of the triangles, which is the
order of blocks in space. Coarse mip levels mix neighbouring squares, which are therefore also neighbours in the room.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from idfslam.errors import ConfigError
from idfslam.views.blending import Floats
from idfslam.views.surface_colour import Shade

_SQUARE = 8  # texels along the edge of a square; raised, the texture is larger and sharper. Chosen by hand
_LEG = _SQUARE - 3  # texels along a triangle's leg; raised, the two triangles of a square would touch
_LARGEST = 16384  # texels along the edge of an atlas; larger ones exceed the limit of common graphics cards


@dataclass(frozen=True, eq=False)
class Atlas:
    """The positions of the texels and corners of F triangles in a square image of `size` texels."""

    size: int
    barycentric: Floats  # (K, 3) of the texels of every triangle
    columns: NDArray[np.int32]  # (F, K)
    rows: NDArray[np.int32]  # (F, K)
    uv: NDArray[np.float64]  # (F, 3, 2) in [0, 1], v upwards


def atlas(faces: int) -> Atlas:
    """The atlas for `faces` triangles. Raises ConfigError if they are too many."""
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
    smooth = np.asarray(mesh.vertex_normals)[mesh.faces].reshape(-1, 3)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return trimesh.Trimesh(corners.reshape(-1, 3), faces, vertex_normals=smooth, visual=visual, process=False)
