"""Meshes of fewer triangles, by quadric error metrics (Garland and Heckbert 1997)."""

import numpy as np
import trimesh


def decimated(mesh: trimesh.Trimesh, faces: int) -> trimesh.Trimesh:
    """The shape of a mesh in at most `faces` triangles, large ones where it is flat, without colours; the shape as it is if it has no more.

    Faces keep their side. Vertex normals are the means of the faces around them.
    """
    import fast_simplification  # takes a quarter of a second to load

    vertices, triangles = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    if len(triangles) > faces:
        vertices, triangles = fast_simplification.simplify(vertices, triangles, target_count=faces)
    return trimesh.Trimesh(vertices, triangles, process=False)
