"""From where a picture of a room shows most of it."""

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]

# All of these were chosen by hand.
_AZIMUTHS = 16  # directions that are tried around the room. More: a slightly better one
_ELEVATIONS = (0.35, 0.6, 0.9)  # [rad] above the floor that are tried. Larger: more floor, less wall


def best_direction(mesh: trimesh.Trimesh, eyes: Floats, up: Floats) -> Floats:
    """The unit direction (3,), from a mesh to who looks at it, that shows most of the surface from its front and as the cameras saw it.

    eyes (N, 3) [m]: places of the cameras. up (3,): a unit vector. So a room seen from all sides is shown from above, and one of which the
    cameras saw one side is shown from there: elsewhere it would fall to pieces.
    """
    directions = np.concatenate([_around(up, elevation) for elevation in _ELEVATIONS])
    return np.asarray(directions[shown(mesh, eyes, directions).argmax()])


def shown(mesh: trimesh.Trimesh, eyes: Floats, directions: Floats) -> Floats:
    """How much surface [m2] each of D directions (D, 3) shows from its front and as the cameras at `eyes` (N, 3) saw it."""
    centres, normals = np.asarray(mesh.triangles_center), np.asarray(mesh.face_normals)
    towards = eyes[cKDTree(eyes).query(centres, workers=-1)[1]] - centres
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    normals = np.where((towards * normals).sum(1, keepdims=True) < 0, -normals, normals)
    seen = np.maximum(normals @ directions.T, 0) * np.maximum(towards @ directions.T, 0)
    return np.asarray(mesh.area_faces @ seen)


def _around(up: Floats, elevation: float) -> Floats:
    """Unit directions (M, 3) all around, `elevation` [rad] above the plane that is perpendicular to `up` (3,)."""
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    side /= np.linalg.norm(side)
    angles = np.arange(_AZIMUTHS)[:, None] * 2 * np.pi / _AZIMUTHS
    level = np.cos(angles) * side + np.sin(angles) * np.cross(up, side)
    return np.asarray(np.cos(elevation) * level + np.sin(elevation) * up)
