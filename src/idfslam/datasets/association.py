"""Images of two cameras that belong together, by their stamps."""

import numpy as np
from numpy.typing import NDArray

TOLERANCE = 0.02  # [s] between a colour image and the depth image or pose that belongs to it


def associate(a: NDArray[np.float64], b: NDArray[np.float64], tolerance: float) -> list[tuple[int, int]]:
    """Pairs (i, k), sorted by i, of sorted stamps a (N,) and b (M,) [s] within the tolerance, the closest first, each used once."""
    first, last = np.searchsorted(b, a - tolerance), np.searchsorted(b, a + tolerance, side="right")
    candidates = sorted((abs(a[i] - b[k]), i, k) for i in range(len(a)) for k in range(first[i], last[i]))
    used_a: set[int] = set()
    used_b: set[int] = set()
    pairs = []
    for _, i, k in candidates:
        if i not in used_a and k not in used_b:
            used_a.add(i)
            used_b.add(k)
            pairs.append((i, k))
    return sorted(pairs)
