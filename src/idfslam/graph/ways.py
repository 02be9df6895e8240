"""Ways: how far it is from one keyframe to another along measured relations, which is how far their poses may have drifted apart."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe

_AHEAD = 2.0  # [m] a turn counts as far as a point so far ahead moves


def ways_from(keyframes: Sequence[Keyframe], a: int, limit: float = np.inf) -> NDArray[np.float64]:
    """(K,) the shortest ways [m] over links from keyframe a to each; infinite where none leads there, or only longer ones than `limit`."""
    pairs = [(i, j) for j, keyframe in enumerate(keyframes) for i in keyframe.linked if i < j]
    if not pairs:
        return np.where(np.arange(len(keyframes)) == a, 0.0, np.inf)
    T = torch.stack([k.T_wk for k in keyframes])
    i, j = torch.tensor(pairs).T
    T_ij = se3.inverse(T[i]) @ T[j]
    length = (T_ij[:, :3, 3].norm(dim=1) + _AHEAD * se3.angle(T_ij)).clamp(min=1e-3).numpy()
    ways = coo_array((length, (i.numpy(), j.numpy())), shape=(len(T), len(T))).tocsr()
    return np.asarray(dijkstra(ways, directed=False, indices=a, limit=limit))
