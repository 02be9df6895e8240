"""A coloured point cloud of the depth images, with normals and one point per voxel."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.export.binary_ply import binary_ply
from idfslam.frame import Frame
from idfslam.geometry.blocks import pack

_EDGE = 0.03  # [1] relative difference in depth to a neighbour beyond which a reading is dropped, since depth cameras measure false depths
#    at edges; raised, fewer are. Chosen by hand
_REACH = 2  # [px] to the neighbours that give a reading's normal. More: less noise, rounder edges. Chosen by hand

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointCloud:
    """N points in the world."""

    points: Floats  # (N, 3) [m]
    colours: Floats  # (N, 3) RGB in [0, 1]
    normals: Floats  # (N, 3) unit, towards the cameras

    def save(self, path: Path) -> None:
        """As binary PLY."""
        reals = zip(("x", "y", "z", "nx", "ny", "nz"), (*self.points.T, *self.normals.T))
        colours = zip(("red", "green", "blue"), np.round(self.colours.T * 255))
        properties = {name: ("<f4", values) for name, values in reals} | {name: ("u1", values) for name, values in colours}
        path.write_bytes(binary_ply(properties))


def fuse(frames: Iterable[tuple[Frame, Floats]], spacing: float) -> PointCloud:
    """The mean point, colour and normal of all readings in each voxel. frames: with their T_wc (4, 4). spacing: edge of a voxel [m]."""
    keys, sums = np.empty(0, np.int64), np.empty((0, 10))
    for frame, T_wc in frames:
        rows = _readings(frame, T_wc)
        keys = np.concatenate([keys, pack(np.floor(rows[:, :3] / spacing))])
        keys, voxel = np.unique(keys, return_inverse=True)
        gathered = np.zeros((len(keys), 10))
        np.add.at(gathered, voxel, np.concatenate([sums, rows]))
        sums = gathered
    count, normals = sums[:, 9:], sums[:, 6:9]
    return PointCloud(sums[:, :3] / count, np.clip(sums[:, 3:6] / count, 0, 1), _unit(normals))


def _readings(frame: Frame, T_wc: Floats) -> Floats:
    """(M, 10): world point, colour, normal and the count 1 of each reading that is not on an edge."""
    z, camera = frame.depth.astype(np.float64), frame.camera
    steep = np.zeros(z.shape, bool)
    down, right = np.abs(np.diff(z, axis=0)) > _EDGE * z[1:], np.abs(np.diff(z, axis=1)) > _EDGE * z[:, 1:]
    for one, other, jump in ((steep[1:], steep[:-1], down), (steep[:, 1:], steep[:, :-1], right)):
        one |= jump
        other |= jump
    rows, columns = np.mgrid[: camera.height, : camera.width]
    local = np.stack([(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z], -1)
    kept = (z > 0) & ~steep
    points, normals = local[kept] @ T_wc[:3, :3].T + T_wc[:3, 3], _normals(local, kept)[kept] @ T_wc[:3, :3].T
    return np.concatenate([points, frame.colour[kept], normals, np.ones((len(points), 1))], 1)


def _normals(points: Floats, kept: NDArray[np.bool_]) -> Floats:
    """(H, W, 3) unit normals towards the camera of an image of points (H, W, 3), by the nearest readings that are kept (H, W)."""
    v, u = np.mgrid[: points.shape[0], : points.shape[1]]

    def neighbour(rows: int, columns: int) -> Floats:
        """The point so many pixels away, or the point itself where that one is not kept."""
        y, x = np.clip(v + rows, 0, v.max()), np.clip(u + columns, 0, u.max())
        return np.where(kept[y, x, None], points[y, x], points)

    across, along = neighbour(0, _REACH) - neighbour(0, -_REACH), neighbour(_REACH, 0) - neighbour(-_REACH, 0)
    normals = np.cross(along, across)
    none = (np.linalg.norm(normals, axis=-1) < 1e-12)[..., None]  # a reading without neighbours: its ray
    normals = _unit(np.where(none, -points, normals))
    return np.where((normals * points).sum(-1, keepdims=True) > 0, -normals, normals)


def _unit(vectors: Floats) -> Floats:
    """Vectors (..., 3) of length 1; z where one has no direction."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-12, vectors / np.maximum(length, 1e-12), np.array([0.0, 0.0, 1.0]))
