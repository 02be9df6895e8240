"""Level coordinates: the world rotated so that z points up, for plans and elevations."""

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.pictures.mesh_renderer import up_direction

Floats = NDArray[np.float64]


def level(mesh: trimesh.Trimesh | None, poses: Floats) -> Floats:
    """R_lw (3, 3) of level coordinates: z up, by the floor and the cameras (N, 4, 4); x and y along the walls, y as the first view."""
    up = up_direction(mesh, poses) if mesh is not None else -poses[0, :3, 1]
    ahead = poses[0, :3, 2] if abs(poses[0, :3, 2] @ up) < 0.95 else -poses[0, :3, 1]
    x = np.cross(ahead, up)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(up, x), up])
    if mesh is None:
        return R
    c, s = np.cos(angle := _walls(mesh, R)), np.sin(angle)
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ R


def _walls(mesh: trimesh.Trimesh, R_lw: Floats) -> float:
    """The smallest angle [rad] about z that aligns the axes with the walls, which are assumed to be perpendicular to each other."""
    x, y, z = R_lw @ np.asarray(mesh.face_normals).T
    upright = np.abs(z) < 0.2
    return float(np.angle((mesh.area_faces * np.exp(4j * np.arctan2(y, x)))[upright].sum()) / 4)


def from_above(R_lw: Floats, centre: Floats, height: float) -> Floats:
    """T_wc (4, 4) of a camera that looks down from `height` [m] above `centre` (3,) in level coordinates; image up is level y."""
    R_lc = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    T = np.eye(4)
    T[:3, :3] = R_lw.T @ R_lc
    T[:3, 3] = R_lw.T @ (centre + np.array([0, 0, height]))
    return T
