"""Triangles of flat surface put together: the vertices in a cell become one (Rossignac and Borrel, "Multi-resolution 3D approximations for
rendering complex scenes", 1993), wherever the surface through the cell is flat.

So a mesh is as fine as its lattice at edges and on small things, and has a fraction of the triangles elsewhere. No triangle is larger than
about a cell, so vertex colours stay as fine as the cells.
"""

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.blocks import pack

Floats = NDArray[np.float64]

# [cells] root mean square distance of the vertices in a cell from the plane through them. More: fewer triangles, coarser shape. Chosen on
# generated rooms
_OFF_PLANE = 0.05
# [1] length of the mean normal in a cell. More: fewer cells are flat; less: the two sides of something thin become one. Chosen by hand
_ALIKE = 0.95
# [1] most times that cells whose triangles would turn over are left as they are (as Garland and Heckbert, "Surface simplification using
# quadric error metrics", 1997, refuse a contraction). More: slower, fewer of the dark specks that such triangles are. Chosen by hand
_ROUNDS = 4
_CHUNK = 1 << 18  # faces whose normals are summed at a time. More: more memory. Chosen by hand


def clustered(vertices: Floats, faces: NDArray[np.int64], cell: float) -> tuple[Floats, NDArray[np.int64]]:
    """The vertices (M, 3) [m] and faces (G, 3) of a mesh (N, 3), (F, 3), with one vertex in each flat cell of edge `cell` [m]."""
    if not len(faces):
        return vertices, faces
    _, of_vertex, number = np.unique(pack(np.floor(vertices / cell)), return_inverse=True, return_counts=True)
    of_vertex = of_vertex.reshape(-1)
    centre = _sums(of_vertex, vertices, len(number)) / number[:, None]
    flat = _is_flat(vertices, faces, of_vertex, centre, cell)
    places = np.concatenate([centre, vertices])  # clusters first, then the vertices that stay
    looked_at = faces  # those with a corner that moved since they were last looked at
    for _ in range(_ROUNDS):
        target = np.where(flat[of_vertex], of_vertex, len(number) + np.arange(len(vertices)))
        turned = looked_at[_turned_over(vertices, looked_at, places, target[looked_at])]
        if not len(turned):
            break
        back = np.zeros_like(flat)
        back[of_vertex[turned]] = True
        flat &= ~back
        looked_at = faces[back[of_vertex][faces].any(1)]
    target = np.where(flat[of_vertex], of_vertex, len(number) + np.arange(len(vertices)))
    faces = _without_folds(target[faces], len(places))
    used = np.zeros(len(places), bool)
    used[faces] = True
    return places[used], (np.cumsum(used) - 1)[faces]


def _turned_over(vertices: Floats, faces: NDArray[np.int64], places: Floats, moved: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(F,) which faces (F, 3) of vertices (N, 3) face the other way with the corners `moved` (F, 3) of places (P, 3).

    Faces that have become an edge have no side, and are none of them.
    """
    turned = np.zeros(len(faces), bool)
    for first in range(0, len(faces), _CHUNK):
        some = slice(first, first + _CHUNK)
        x, y, z = (before * after for before, after in zip(_normals(vertices, faces[some]), _normals(places, moved[some])))
        turned[some] = x + y + z < 0
    return turned


def _normals(vertices: Floats, faces: NDArray[np.int64]) -> tuple[Floats, Floats, Floats]:
    """The components (F,) of the normals of faces (F, 3) of vertices (N, 3), as long as twice their area."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    (ux, uy, uz), (vx, vy, vz) = (b - a).T, (c - a).T  # by components: `np.cross` takes four times as long
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


def _without_folds(faces: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Faces (G, 3) on `count` vertices without those that have become an edge, and without pairs that have become the sides of one."""
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    low, middle, high = np.sort(faces, 1).T
    pair = np.unique(low * count + middle, return_inverse=True)[1].reshape(-1)
    same, number = np.unique(pair * count + high, return_inverse=True, return_counts=True)[1:]
    return faces[number[same.reshape(-1)] == 1]


def _is_flat(vertices: Floats, faces: NDArray[np.int64], of_vertex: NDArray[np.int64], centre: Floats, cell: float) -> NDArray[np.bool_]:
    """(C,) whether the surface through each cluster is flat. of_vertex (N,): the cluster of each vertex. centre (C, 3) [m]."""
    total, area = np.zeros_like(centre), np.zeros(len(centre))
    for first in range(0, len(faces), _CHUNK):
        some = faces[first : first + _CHUNK]
        normals = np.stack(_normals(vertices, some), 1)
        areas = np.linalg.norm(normals, axis=1)
        for corner in range(3):
            cluster = of_vertex[some[:, corner]]
            total += _sums(cluster, normals, len(centre))
            area += np.bincount(cluster, areas, len(centre))
    length = np.linalg.norm(total, axis=1)
    plane = total / np.maximum(length, 1e-12)[:, None]
    off = ((vertices - centre[of_vertex]) * plane[of_vertex]).sum(1)
    mean_square = np.bincount(of_vertex, off * off, len(centre)) / np.maximum(np.bincount(of_vertex, minlength=len(centre)), 1)
    return (length > _ALIKE * area) & (mean_square < (_OFF_PLANE * cell) ** 2)


def _sums(index: NDArray[np.int64], values: Floats, count: int) -> Floats:
    """(count, 3) the sums of values (N, 3) with the same index (N,)."""
    return np.stack([np.bincount(index, column, count) for column in values.T], 1)
