"""Points sampled on surfaces, and their distances from another surface."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from idfslam.evaluation.point_triangle import nearest_triangle

Floats = NDArray[np.float64]

_CANDIDATES = 8  # triangles to which a point's distance is measured; raised, the nearest one is missed less often. Chosen by hand


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Points (N, 3) [m] on a surface, each with its triangle (N, 3, 3)."""

    points: Floats
    triangles: Floats

    @staticmethod
    def of(mesh: trimesh.Trimesh, count: int, seed: int) -> "SurfaceSamples":
        """Points sampled uniformly by area."""
        points, faces = trimesh.sample.sample_surface(mesh, count, seed=seed)[:2]
        return SurfaceSamples(np.asarray(points), np.asarray(mesh.triangles[faces]))

    def moved(self, T: Floats) -> "SurfaceSamples":
        """The same by a rigid T (4, 4)."""
        R_t, t = T[:3, :3].T, T[:3, 3]
        return SurfaceSamples(self.points @ R_t + t, self.triangles @ R_t + t)


def to_points(points: Floats, target: SurfaceSamples) -> tuple[Floats, Floats]:
    """Distances [m] (N,) from points (N, 3) to the nearest samples of a surface, and the triangles of these (N, 3, 3)."""
    distance, nearest = cKDTree(target.points).query(points, workers=-1)
    return distance, target.triangles[nearest]


def to_surface(points: Floats, target: SurfaceSamples, mesh: trimesh.Trimesh) -> tuple[Floats, Floats]:
    """Distances [m] (N,) from points (N, 3) to the nearest triangle of a mesh, and these (N, 3, 3); `target` are samples of its surface.

    The candidates are the triangles of the nearest samples, which cover large triangles, and those with the nearest centres, which cover
    small ones.
    """
    all_triangles = np.asarray(mesh.triangles)
    triangles = np.concatenate([target.triangles, all_triangles])
    tree = cKDTree(np.concatenate([target.points, all_triangles.mean(1)]))
    candidates = tree.query(points, k=np.arange(1, _CANDIDATES + 1), workers=-1)[1]
    distance, nearest = nearest_triangle(points, triangles, candidates)
    return distance, triangles[nearest]


def median_angle(triangles: Floats, others: Floats) -> float:
    """The median angle [deg] between the planes of triangles and others, (N, 3, 3) each. Which side is the front does not matter."""
    a, b = (np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in (triangles, others))
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    cosine = np.abs((a * b).sum(1))[lengths > 0] / lengths[lengths > 0]
    return float(np.degrees(np.arccos(np.clip(np.median(cosine), 0, 1))))
