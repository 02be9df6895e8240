"""Iterative closest point, point to point (Besl and McKay, "A method for registration of 3-D shapes", PAMI 1992)."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from idfslam.geometry.trajectory import align

Floats = NDArray[np.float64]

_POINTS = 50_000  # of the source that are paired, evenly spread; raised, slower, and hardly more exact. Chosen by hand
_ITERATIONS = 30  # at most; raised, a large misalignment is corrected further. Chosen by hand
_CONVERGED = 1e-7  # [1] largest change of the transform's numbers at which it ends; raised, it ends earlier. Chosen by hand


def icp(source: Floats, target: Floats, *, threshold: float) -> Floats:
    """T_target_source (4, 4) from points (N, 3) and (M, 3), from the identity. Points farther apart than `threshold` [m] are not paired.

    It ends with the transform so far if fewer than three pairs are left.
    """
    tree, T = cKDTree(target), np.eye(4)
    chosen = source[:: max(1, len(source) // _POINTS)]
    for _ in range(_ITERATIONS):
        moved = chosen @ T[:3, :3].T + T[:3, 3]
        distance, index = tree.query(moved, distance_upper_bound=threshold, workers=-1)
        near = np.isfinite(distance)
        if near.sum() < 3:
            return T
        step = align(moved[near], target[index[near]])
        T = step @ T
        if np.abs(step - np.eye(4)).max() < _CONVERGED:
            return T
    return T
