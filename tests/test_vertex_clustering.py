"""Vertices of flat surface put together: a plane, an edge, the two sides of a board, and a closed surface."""

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from idfslam.mapping.vertex_clustering import clustered

FINE, CELL = 0.01, 0.02


def grid(height: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A sheet of quads of 1 cm, two triangles each, over heights (N, N) [m]."""
    n = len(height)
    x, y = np.meshgrid(np.arange(n) * FINE + 0.003, np.arange(n) * FINE + 0.003, indexing="ij")
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = (k[i : n - 1 + i, j : n - 1 + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    return np.stack([x.ravel(), y.ravel(), height.ravel()], 1), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def test_a_plane_has_a_quarter_of_its_triangles_and_stays_where_it_is() -> None:
    x, y = np.meshgrid(np.arange(40) * FINE, np.arange(40) * FINE, indexing="ij")
    vertices, faces = clustered(*grid(0.3 * x - 0.1 * y + 0.5), CELL)
    assert len(vertices) < 0.4 * 1600 and len(faces) < 0.4 * 2 * 39**2
    np.testing.assert_allclose(vertices[:, 2], 0.3 * (vertices[:, 0] - 0.003) - 0.1 * (vertices[:, 1] - 0.003) + 0.5, atol=1e-12)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert (mesh.face_normals[:, 2] > 0.9).all()  # none is turned over
    assert mesh.edges_unique_length.max() < 2 * CELL * 1.5


def test_no_triangle_is_turned_over_where_some_cells_are_flat() -> None:
    """Of a rough sheet's marching cubes, 33 pairs of 6 000 triangles would."""
    x, y, z = np.mgrid[0:60, 0:60, 0:30] * FINE
    rough = np.random.default_rng(0).normal(0, 0.0012, x.shape)
    fine, faces, _, _ = marching_cubes((z - 0.3 * x - 0.1 * y - 0.05 + rough).astype(np.float32), 0.0)
    mesh = trimesh.Trimesh(*clustered(fine.astype(np.float64) * FINE, faces.astype(np.int64), CELL), process=False)
    assert 0.3 * len(faces) < len(mesh.faces) < 0.8 * len(faces)
    assert mesh.face_adjacency_angles.max() < np.deg2rad(115)


def test_an_edge_of_63_degrees_keeps_its_vertices() -> None:
    x = np.meshgrid(np.arange(40) * FINE, np.arange(40) * FINE, indexing="ij")[0]
    before, faces = grid(np.maximum(0, 2 * (x - 0.2)))
    vertices, faces = clustered(before, faces, CELL)
    kept = (vertices[:, None] == before[None]).all(-1).any(1)
    edge = np.abs(vertices[:, 0] - 0.203) < 1e-9
    assert edge.sum() == 40 and kept[edge].all()
    assert len(vertices) < 0.5 * len(before)


def test_the_sides_of_a_thin_board_stay_apart() -> None:
    front, faces = grid(np.full((40, 40), 0.004))
    back = front * [1, 1, 0] + [0, 0, 0.012]
    vertices, faces = clustered(np.concatenate([front, back]), np.concatenate([faces, faces[:, ::-1] + len(front)]), CELL)
    assert set(np.round(vertices[:, 2], 4)) == {0.004, 0.012}  # both sides pass through the same cells


@pytest.mark.parametrize("radius", [0.05, 0.4])
def test_a_closed_surface_stays_closed(radius: float) -> None:
    ball = trimesh.creation.icosphere(subdivisions=6 if radius > 0.1 else 4, radius=radius)
    mesh = trimesh.Trimesh(*clustered(np.asarray(ball.vertices), np.asarray(ball.faces, np.int64), CELL), process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.euler_number == 2
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - radius).max() < 0.05 * CELL
    assert radius < 0.1 or len(mesh.faces) < 0.5 * len(ball.faces)


def test_nothing_stays_nothing() -> None:
    vertices, faces = clustered(np.zeros((0, 3)), np.zeros((0, 3), np.int64), CELL)
    assert len(vertices) == len(faces) == 0
