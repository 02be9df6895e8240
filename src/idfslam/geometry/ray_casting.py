"""Ray casting against a triangle mesh with Embree, for depth images and lines of sight."""

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
    """Where each of N rays first hits the mesh."""

    distance: Floats  # (N,) in units of the ray's direction; inf where it hits nothing
    face: NDArray[np.int32]  # (N,) index; -1 where it hits nothing
    barycentric: Floats  # (N, 2) weights of the face's second and third vertices; undefined where it hits nothing


class RayCaster:
    """A mesh prepared for ray casting; a ray hits both sides of a face."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self._scene = rtcore_scene.EmbreeScene()
        self._mesh = TriangleMesh(self._scene, np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32))

    def cast(self, origins: Floats, directions: Floats) -> Hits:
        """The first hits of rays from origins (N, 3), or from one (3,) [m], along directions (N, 3) of any length."""
        directions = np.ascontiguousarray(directions, np.float32)
        if len(directions) == 0:
            return Hits(np.zeros(0, np.float32), np.zeros(0, np.int32), np.zeros((0, 2), np.float32))
        origins = np.ascontiguousarray(np.broadcast_to(origins, directions.shape), np.float32)
        hits = self._scene.run(origins, directions, output=1)
        face = hits["primID"]
        distance = np.where(face >= 0, hits["tfar"], np.float32(np.inf))
        return Hits(distance, face, np.stack([hits["u"], hits["v"]], -1))


def pixel_rays(camera: Camera, T_wc: NDArray[np.float64], pixels: NDArray[np.integer] | None = None) -> Floats:
    """Ray directions (N, 3) in the world, for flat pixel indices (N,) or for all pixels row by row.

    z = 1 in the camera's frame, so that the distance along a ray is the z-depth.
    """
    right, down, forward = T_wc[:3, :3].T
    columns = ((np.arange(camera.width) - camera.cx) / camera.fx)[:, None] * right
    rows = ((np.arange(camera.height) - camera.cy) / camera.fy)[:, None] * down + forward
    if pixels is None:
        return (rows[:, None] + columns).astype(np.float32).reshape(-1, 3)
    v, u = np.divmod(pixels, camera.width)
    return (rows[v] + columns[u]).astype(np.float32)
