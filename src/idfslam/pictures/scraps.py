"""Leaves out what makes the picture of a mesh untidy."""

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

# [1] share of the surface below which a piece that touches nothing is left out. More: small objects go. Chosen by hand
_SCRAP = 0.001


def without_scraps(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh without pieces that touch no other and have hardly any surface."""
    a, b = mesh.edges_unique.T
    piece = connected_components(coo_matrix((np.ones(len(a), bool), (a, b)), (len(mesh.vertices),) * 2))[1][mesh.faces[:, 0]]
    area = np.bincount(piece, mesh.area_faces)
    kept = mesh.copy()
    kept.update_faces(area[piece] >= _SCRAP * mesh.area)
    kept.remove_unreferenced_vertices()
    return kept
