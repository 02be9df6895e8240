"""Level coordinates: the world rotated so that z points up, for plans, elevations and exports."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_LEVEL_DEGREES = 10.0  # [degrees] a face within this of horizontal is part of a floor, table or ceiling; raised, ramps count too
# [1] share of the surface that must be horizontal for gravity to be known. Raised, fewer places are set upright by their floor. Faces
# in random directions have 0.015, a kitchen 0.2. Chosen by hand.
_LEAST_LEVEL = 0.05
_LOOKING_DOWN = 50.0  # [degrees] tilt at which a floor is looked for second. Raised, one seen at a slant is missed. Chosen by hand
_STEEPEST = 60.0  # [degrees] mean tilt of the cameras that is believed. Raised, a wall may pass for a floor. Chosen by hand


@dataclass(frozen=True, eq=False)
class LevelFrame:
    """Level coordinates: z up, x and y along the walls, y as far as possible as the first view; the origin is the world's."""

    R_lw: Floats  # (3, 3)
    by_gravity: bool  # False: no floor, table or ceiling was seen, and z is the first camera's up


def level(mesh: trimesh.Trimesh | None, poses: Floats) -> LevelFrame:
    """The level coordinates of a place by its mesh, if there is one, and the cameras (N, 4, 4) that saw it."""
    up = -poses[0, :3, 1]
    found = mesh is not None and _is_level(mesh, by_floor := up_direction(mesh, poses))
    if found:
        up = by_floor
    ahead = poses[0, :3, 2] if abs(poses[0, :3, 2] @ up) < 0.95 else -poses[0, :3, 1]
    x = np.cross(ahead, up)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(up, x), up])
    if mesh is None:
        return LevelFrame(R, found)
    c, s = np.cos(angle := _walls(mesh, R)), np.sin(angle)
    return LevelFrame(np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ R, found)


def up_direction(mesh: trimesh.Trimesh, poses: Floats) -> Floats:
    """(3,) the room's up direction: the mean up of the cameras (N, 4, 4), refined by the normals of floor and ceiling.

    If nothing is level so, the cameras may have looked down, as at a desk: then what faces up is looked for nearer to their view.
    """
    cameras = -poses[:, :3, 1].mean(0)
    cameras /= np.linalg.norm(cameras)
    up = _refined(mesh, cameras, one_sided=False)
    ahead = poses[:, :3, 2].mean(0)
    ahead -= (ahead @ cameras) * cameras
    if _is_level(mesh, up) or np.linalg.norm(ahead) < 1e-6:
        return up
    tilt = np.deg2rad(_LOOKING_DOWN)
    below = _refined(mesh, np.cos(tilt) * cameras - np.sin(tilt) * ahead / np.linalg.norm(ahead), one_sided=True)
    return below if _is_level(mesh, below) and below @ cameras > np.cos(np.deg2rad(_STEEPEST)) else up


def _refined(mesh: trimesh.Trimesh, up: Floats, *, one_sided: bool) -> Floats:
    """The mean normal of the faces around `up` (3,), in ever narrower cones. one_sided: only of those that face that way."""
    normals, areas = np.asarray(mesh.face_normals), np.asarray(mesh.area_faces)
    for degrees in (35, 25, 15, 10, 5, 5):
        cosine = normals @ up
        near = (cosine if one_sided else np.abs(cosine)) > np.cos(np.deg2rad(degrees))
        if areas[near].sum() == 0:
            break
        up = ((areas * np.sign(cosine))[near, None] * normals[near]).sum(0)
        up /= np.linalg.norm(up)
    return np.asarray(up)


def _is_level(mesh: trimesh.Trimesh, up: Floats) -> bool:
    """Whether enough of the surface is perpendicular to `up` (3,)."""
    horizontal = np.abs(np.asarray(mesh.face_normals) @ up) > np.cos(np.deg2rad(_LEVEL_DEGREES))
    return bool(mesh.area_faces[horizontal].sum() >= _LEAST_LEVEL * mesh.area)


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
