"""Ways: how far it is from one keyframe to another along measured relations, which is how far their poses may have drifted apart."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from idfslam.graph.keyframe import Keyframe

_AHEAD = 2.0  # [m] a turn counts as far as a point so far ahead moves


def ways_from(keyframes: Sequence[Keyframe], a: int, limit: float = np.inf) -> NDArray[np.float64]:
    """(K,) the shortest ways [m] over links from keyframe a to each; infinite where none leads there, or only longer ones than `limit`."""
    pairs = [(i, j) for j, keyframe in enumerate(keyframes) for i in keyframe.linked if i < j]
    if not pairs:
        return np.where(np.arange(len(keyframes)) == a, 0.0, np.inf)
    T = torch.stack([k.T_wk for k in keyframes]).numpy()
    i, j = np.array(pairs).T
    length = np.maximum(distances(T[i], T[j]), 1e-3)
    ways = coo_array((length, (i, j)), shape=(len(T), len(T))).tocsr()
    return np.asarray(dijkstra(ways, directed=False, indices=a, limit=limit))


def distances(T_a: NDArray[np.float64], T_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(E,) how far it is [m] from poses (E, 4, 4) to others: their shift, and their turn as what it moves ahead of the camera."""
    shift = np.linalg.norm(T_b[:, :3, 3] - T_a[:, :3, 3], axis=1)
    chord = np.linalg.norm(T_b[:, :3, :3] - T_a[:, :3, :3], axis=(1, 2))
    return shift + _AHEAD * 2 * np.arcsin(np.minimum(chord / 8**0.5, 1.0))  # of rotations, |B - A| is the square root of 8 sin(angle / 2)
