"""A mesh made ready for other programs: no face without area, none twice, unit normals at the vertices."""

from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

_LEAST_HEIGHT = 1e-7  # [m] of a triangle. Files hold coordinates as float32, whose steps are 2e-7 m at 4 m. Raised, larger faces go


def cleaned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh without faces that have no area as float32 or lie on another one, with vertex normals. It faces the same side."""
    out = trimesh.Trimesh(mesh.vertices.astype(np.float32), mesh.faces, visual=_visual(mesh), process=False)
    _, first, vertex = np.unique(out.vertices, axis=0, return_index=True, return_inverse=True)
    out.faces = first[vertex.ravel()][out.faces]
    out.update_faces(out.nondegenerate_faces(height=_LEAST_HEIGHT) & out.unique_faces())
    out.remove_unreferenced_vertices()
    return turned(out, np.eye(4))


def turned(mesh: trimesh.Trimesh, T: NDArray[np.float64]) -> trimesh.Trimesh:
    """The mesh and its vertex normals in other axes, by the rigid T (4, 4)."""
    R, t = T[:3, :3], T[:3, 3]
    normals = _vertex_normals(mesh) @ R.T
    return trimesh.Trimesh(mesh.vertices @ R.T + t, mesh.faces, vertex_normals=normals, visual=_visual(mesh), process=False)


def _visual(mesh: trimesh.Trimesh) -> Any:
    """A copy of the colours or the texture: a visual belongs to one mesh."""
    visual: Any = mesh.visual
    return visual.copy()


def _vertex_normals(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """(V, 3) unit normals: the mean of the faces around a vertex, or one face's where they cancel out."""
    normals = np.array(mesh.vertex_normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    flat = length[:, 0] < 1e-6
    if flat.any():
        normals[flat] = mesh.face_normals[mesh.vertex_faces[flat, 0]]
        length[flat] = 1.0
    return np.asarray(normals / length)
