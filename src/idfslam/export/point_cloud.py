"""A coloured point cloud of the depth images, with one point per voxel."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.frame import Frame

_EDGE = 0.03  # relative difference in depth to a neighbour beyond which a reading is dropped: depth cameras measure false depths at edges
_OFFSET = 1 << 20  # voxel coordinates are packed into 21 bits each


@dataclass(frozen=True, eq=False)
class PointCloud:
    """N points in the world."""

    points: NDArray[np.float64]  # (N, 3) [m]
    colours: NDArray[np.float64]  # (N, 3) RGB in [0, 1]

    def save(self, path: Path) -> None:
        """As PLY."""
        trimesh.PointCloud(self.points, np.round(self.colours * 255).astype(np.uint8)).export(path, file_type="ply")


def fuse(frames: Iterable[tuple[Frame, NDArray[np.float64]]], spacing: float) -> PointCloud:
    """The mean point and colour of all readings in each voxel. frames: with their T_wc (4, 4). spacing: edge of a voxel [m]."""
    keys, sums = np.empty(0, np.int64), np.empty((0, 7))
    for frame, T_wc in frames:
        rows = _readings(frame, T_wc)
        x, y, z = (np.floor(rows[:, :3] / spacing).astype(np.int64) + _OFFSET).T
        keys = np.concatenate([keys, (x << 42) | (y << 21) | z])
        keys, voxel = np.unique(keys, return_inverse=True)
        gathered = np.zeros((len(keys), 7))
        np.add.at(gathered, voxel, np.concatenate([sums, rows]))
        sums = gathered
    return PointCloud(sums[:, :3] / sums[:, 6:], np.clip(sums[:, 3:6] / sums[:, 6:], 0, 1))


def _readings(frame: Frame, T_wc: NDArray[np.float64]) -> NDArray[np.float64]:
    """(M, 7): world point, colour and the count 1 of each reading that is not on an edge."""
    z, camera = frame.depth.astype(np.float64), frame.camera
    steep = np.zeros(z.shape, bool)
    down, right = np.abs(np.diff(z, axis=0)) > _EDGE * z[1:], np.abs(np.diff(z, axis=1)) > _EDGE * z[:, 1:]
    for one, other, jump in ((steep[1:], steep[:-1], down), (steep[:, 1:], steep[:, :-1], right)):
        one |= jump
        other |= jump
    v, u = np.nonzero((z > 0) & ~steep)
    z = z[v, u]
    local = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], -1)
    return np.concatenate([local @ T_wc[:3, :3].T + T_wc[:3, 3], frame.colour[v, u], np.ones((len(z), 1))], 1)
