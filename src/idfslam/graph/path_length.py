"""Path lengths: how far one keyframe is from another along edges of the pose graph, which bounds how far their poses have drifted apart."""

from collections.abc import Sequence
from itertools import chain

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from idfslam.graph.keyframe import Keyframe

_AHEAD = 2.0  # [m] a turn counts as the shift of a point so far ahead, about the depth of a room. More: turns count for more drift


def edge_pairs(keyframes: Sequence[Keyframe]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The pairs of stored keyframes with an edge: the earlier (E,), and the later (E,), by which they are sorted."""
    counts = [len(keyframe.edges) for keyframe in keyframes]
    i = np.fromiter(chain.from_iterable(sorted(keyframe.edges) for keyframe in keyframes), np.int64, sum(counts))
    j = np.repeat(np.arange(len(keyframes)), counts)
    return i[i < j], j[i < j]


def path_lengths(keyframes: Sequence[Keyframe], a: int) -> NDArray[np.float64]:
    """(K,) the shortest paths [m] over edges from keyframe a to each; infinite where there is none."""
    i, j = edge_pairs(keyframes)
    T = torch.stack([k.T_wk for k in keyframes]).numpy()
    length = np.maximum(distances(T[i], T[j]), 1e-3)
    return np.asarray(dijkstra(coo_array((length, (i, j)), shape=(len(T), len(T))).tocsr(), directed=False, indices=a))


def distances(T_a: NDArray[np.float64], T_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(E,) distances [m] between poses (E, 4, 4): their shift, and their turn as the shift of a point ahead of the camera."""
    shift = np.linalg.norm(T_b[:, :3, 3] - T_a[:, :3, 3], axis=1)
    chord = np.linalg.norm(T_b[:, :3, :3] - T_a[:, :3, :3], axis=(1, 2))
    return shift + _AHEAD * 2 * np.arcsin(np.minimum(chord / 8**0.5, 1.0))  # for rotations A and B, |B - A| = sqrt(8) sin(angle / 2)
