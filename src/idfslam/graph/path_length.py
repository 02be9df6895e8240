"""Path lengths between keyframes along edges of the pose graph. They bound how far two poses have drifted apart."""

from collections.abc import Sequence
from itertools import chain

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from idfslam.geometry.pose_distance import pose_distances
from idfslam.graph.keyframe import Keyframe


def edge_pairs(keyframes: Sequence[Keyframe]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The pairs of stored keyframes with an edge: the earlier ones (E,) and the later ones (E,), sorted by the later."""
    counts = [len(keyframe.edges) for keyframe in keyframes]
    i = np.fromiter(chain.from_iterable(sorted(keyframe.edges) for keyframe in keyframes), np.int64, sum(counts))
    j = np.repeat(np.arange(len(keyframes)), counts)
    return i[i < j], j[i < j]


def path_lengths(keyframes: Sequence[Keyframe], a: int) -> NDArray[np.float64]:
    """The lengths (K,) [m] of the shortest paths of edges from keyframe a to each; infinite without a path."""
    i, j = edge_pairs(keyframes)
    T = torch.stack([k.T_wk for k in keyframes]).numpy()
    length = np.maximum(pose_distances(T[i], T[j]), 1e-3)
    return np.asarray(dijkstra(coo_array((length, (i, j)), shape=(len(T), len(T))).tocsr(), directed=False, indices=a))
