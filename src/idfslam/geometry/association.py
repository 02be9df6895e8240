"""Pairs of time stamps that belong together: colour and depth images of two cameras, frames and reference poses."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

TOLERANCE = 0.02  # [s] between stamps that belong together, as in the TUM benchmark; raised, images of different moments become pairs


def associate(a: ArrayLike, b: ArrayLike, *, tolerance: float = TOLERANCE) -> NDArray[np.int64]:
    """Pairs (M, 2) of indices into the stamps a (N,) and b (K,) [s], sorted by a's index; no stamp is used twice.

    The closest pairs within `tolerance` [s] are taken first, as in the TUM benchmark's own tool (associate.py); of equally close pairs,
    the earlier.
    """
    first, second = np.asarray(a, np.float64), np.asarray(b, np.float64)
    order = np.argsort(second, kind="stable")
    low = np.searchsorted(second[order], first - tolerance, side="left")
    high = np.searchsorted(second[order], first + tolerance, side="right")
    count = high - low
    i = np.repeat(np.arange(len(first)), count)
    offset = np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count)
    j = order[np.repeat(low, count) + offset]
    used_a, used_b = np.zeros(len(first), bool), np.zeros(len(second), bool)
    pairs = []
    for k in np.argsort(np.abs(first[i] - second[j]), kind="stable"):
        if not (used_a[i[k]] or used_b[j[k]]):
            used_a[i[k]] = used_b[j[k]] = True
            pairs.append((i[k], j[k]))
    return np.array(sorted(pairs), np.int64).reshape(-1, 2)
