"""Rays against a triangle mesh with Embree: depth images, lines of sight."""

from dataclasses import dataclass

import numpy as np
import trimesh
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Hits:
    """Where each of N rays meets the mesh first."""

    distance: Floats  # (N,) in units of the ray's direction; inf where it meets nothing
    face: NDArray[np.int32]  # (N,) index; -1 where it meets nothing
    barycentric: Floats  # (N, 2) weights of the face's second and third vertex


class RayCaster:
    """A mesh prepared for ray casting; both sides of a face count."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self._scene = rtcore_scene.EmbreeScene()
        self._mesh = TriangleMesh(self._scene, np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32))

    def cast(self, origins: Floats, directions: Floats) -> Hits:
        """Origins (N, 3) or (3,) [m], directions (N, 3) -> hits."""
        directions = np.ascontiguousarray(directions, np.float32)
        if len(directions) == 0:
            return Hits(np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros((0, 2), np.float32))
        origins = np.ascontiguousarray(np.broadcast_to(origins, directions.shape), np.float32)
        answer = self._scene.run(origins, directions, output=1)
        face = answer["primID"]
        distance = np.where(face >= 0, answer["tfar"], np.float32(np.inf))
        return Hits(distance, face, np.stack([answer["u"], answer["v"]], -1))


def pixel_rays(camera: Camera, T_wc: NDArray[np.float64], pixels: NDArray[np.integer] | None = None) -> Floats:
    """World directions (N, 3) of flat pixel indices (N,), or of all pixels row by row; z = 1 in the camera, so that distance IS depth."""
    right, down, forward = T_wc[:3, :3].T
    columns = ((np.arange(camera.width) - camera.cx) / camera.fx)[:, None] * right
    rows = ((np.arange(camera.height) - camera.cy) / camera.fy)[:, None] * down + forward
    if pixels is None:
        return (rows[:, None] + columns).astype(np.float32).reshape(-1, 3)
    v, u = np.divmod(pixels, camera.width)
    return (rows[v] + columns[u]).astype(np.float32)


def render_depth(caster: RayCaster, T_wc: NDArray[np.float64], camera: Camera) -> Floats:
    """The z-depth image (H, W) [m] seen from T_wc (4, 4); 0 where there is no surface."""
    distance = caster.cast(T_wc[:3, 3].astype(np.float32), pixel_rays(camera, T_wc)).distance
    return np.where(np.isfinite(distance), distance, np.float32(0)).reshape(camera.height, camera.width)
