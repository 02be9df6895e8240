"""Ways: how far it is from one keyframe to another along measured relations, which is how far their poses may have drifted apart."""

from collections.abc import Sequence
from itertools import chain

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from idfslam.graph.keyframe import Keyframe

_AHEAD = 2.0  # [m] a turn counts as far as a point so far ahead moves


def linked_pairs(keyframes: Sequence[Keyframe]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Stored keyframes that are linked: the earlier of each two (E,), and the later, which they are sorted by."""
    counts = [len(keyframe.linked) for keyframe in keyframes]
    i = np.fromiter(chain.from_iterable(sorted(keyframe.linked) for keyframe in keyframes), np.int64, sum(counts))
    j = np.repeat(np.arange(len(keyframes)), counts)
    return i[i < j], j[i < j]


def ways_from(keyframes: Sequence[Keyframe], a: int) -> NDArray[np.float64]:
    """(K,) the shortest ways [m] over links from keyframe a to each; infinite where none leads there."""
    i, j = linked_pairs(keyframes)
    T = torch.stack([k.T_wk for k in keyframes]).numpy()
    length = np.maximum(distances(T[i], T[j]), 1e-3)
    return np.asarray(dijkstra(coo_array((length, (i, j)), shape=(len(T), len(T))).tocsr(), directed=False, indices=a))


def distances(T_a: NDArray[np.float64], T_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(E,) how far it is [m] from poses (E, 4, 4) to others: their shift, and their turn as what it moves ahead of the camera."""
    shift = np.linalg.norm(T_b[:, :3, 3] - T_a[:, :3, 3], axis=1)
    chord = np.linalg.norm(T_b[:, :3, :3] - T_a[:, :3, :3], axis=(1, 2))
    return shift + _AHEAD * 2 * np.arcsin(np.minimum(chord / 8**0.5, 1.0))  # of rotations, |B - A| is the square root of 8 sin(angle / 2)
