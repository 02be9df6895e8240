"""Writes trajectories in the format of KITTI's odometry benchmark: one pose a line, the upper three rows of T_wc; no time stamps.

Its camera axes (x right, y down, z forward) and its world (the first camera) are the same as in this package.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def save_kitti(path: Path, poses: NDArray[np.float64]) -> None:
    """Writes camera-to-world poses (N, 4, 4)."""
    path.write_text("".join(" ".join(f"{x:.9g}" for x in T[:3].ravel()) + "\n" for T in poses), encoding="utf-8")
