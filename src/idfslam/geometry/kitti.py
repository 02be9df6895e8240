"""Trajectories in the format of KITTI's odometry benchmark: one pose a line, the upper three rows of T_wc; no time stamps.

Its camera axes (x right, y down, z forward) and its world (the first camera) are the same as in this package.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.trajectory import Trajectory, TrajectoryError
from idfslam.storage.text_file import read_text

_FPS = 30.0  # [Hz] assumed, since the format has no stamps


def save_kitti(path: Path, poses: NDArray[np.float64]) -> None:
    """Writes camera-to-world poses (N, 4, 4)."""
    path.write_text("".join(" ".join(f"{x:.9g}" for x in T[:3].ravel()) + "\n" for T in poses), encoding="utf-8")


def load_kitti(path: Path) -> Trajectory:
    """Reads poses, with stamps at 30 Hz. Raises `TrajectoryError`, which names file and line."""
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        try:
            row = [float(word) for word in line.split()]
        except ValueError as error:
            raise TrajectoryError(f"{path}:{number}: a word is not a number; expected the 12 of a 3 x 4 pose") from error
        if len(row) not in (0, 12):
            raise TrajectoryError(f"{path}:{number}: {len(row)} values; expected the 12 of a 3 x 4 pose")
        rows += [row] if row else []
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = np.array(rows).reshape(-1, 3, 4)
    return Trajectory(np.arange(len(rows)) / _FPS, poses)
