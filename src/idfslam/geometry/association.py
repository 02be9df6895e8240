"""Pairs of time stamps that belong together: colour and depth images of two cameras, frames and reference poses."""

import heapq
from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

TOLERANCE = 0.02  # [s] between stamps that belong together, as in the TUM benchmark; raised, images of different moments become pairs


def associate(a: ArrayLike, b: ArrayLike, *, tolerance: float = TOLERANCE) -> NDArray[np.int64]:
    """Pairs (M, 2) of indices into the stamps a (N,) and b (K,) [s], sorted by a's index; no stamp is used twice.

    The closest pairs within `tolerance` [s] are taken first, as in the TUM benchmark's own tool (associate.py); of equally close pairs,
    the earlier. A stamp that is not finite has no partner. The time is O(n log n) in n = N + K, also where many stamps are equal.
    """
    first, second = np.asarray(a, np.float64).reshape(-1), np.asarray(b, np.float64).reshape(-1)
    return np.array(sorted(_Moments(first, second).pairs(tolerance)), np.int64).reshape(-1, 2)


class _Moments:
    """The different stamps in the order of time, and the indices in a and b that have each. Used ones are removed.

    Of all pairs that are left, the closest is one of neighbours in this order, so that only neighbours are compared.
    """

    def __init__(self, a: NDArray[np.float64], b: NDArray[np.float64]) -> None:
        times = np.unique(np.concatenate([a[np.isfinite(a)], b[np.isfinite(b)]]))
        self._times: list[float] = times.tolist()
        self._free: list[tuple[deque[int], deque[int]]] = [(deque(), deque()) for _ in self._times]  # indices in a, in b
        for series, stamps in enumerate((a, b)):
            for i in np.flatnonzero(np.isfinite(stamps)).tolist():
                self._free[int(np.searchsorted(times, stamps[i]))][series].append(i)
        self._before, self._after = list(range(-1, len(times) - 1)), [*range(1, len(times)), -1]  # the neighbours; -1: none

    def pairs(self, tolerance: float) -> list[tuple[int, int]]:
        """All pairs within `tolerance` [s], the closest first. Afterwards no more are left."""
        found = []
        for moment, (i, j) in enumerate(self._free):
            while i and j:
                found.append((i.popleft(), j.popleft()))
            if not i and not j:
                self._remove(moment)
        closest = [pair for moment in range(len(self._times)) for pair in self._neighbours(moment, tolerance)]
        heapq.heapify(closest)
        while closest:
            pair = heapq.heappop(closest)
            _, _, left, right = pair
            if self._after[left] != right:
                continue  # one of the two has no stamp left
            if [pair] != (now := self._neighbours(left, tolerance)):
                heapq.heappush(closest, now[0])  # its first stamp has found another partner: the next one's turn comes later
                continue
            in_a, in_b = self._ends(left, right)
            found.append((in_a.popleft(), in_b.popleft()))
            nearest = left if any(self._free[left]) else self._before[left]
            for moment in (left, right):
                if not any(self._free[moment]):
                    self._remove(moment)
            for pair in self._neighbours(nearest, tolerance):
                heapq.heappush(closest, pair)
        return found

    def _neighbours(self, left: int, tolerance: float) -> list[tuple[float, int, int, int]]:
        """Distance [s], index in a, and the moments of the pair that a moment and the next one are; none if they are no pair."""
        right = self._after[left] if left >= 0 else -1
        if right < 0 or self._times[right] - self._times[left] > tolerance:
            return []
        in_a, in_b = self._ends(left, right)
        return [(self._times[right] - self._times[left], in_a[0], left, right)] if in_a and in_b else []

    def _ends(self, left: int, right: int) -> tuple[deque[int], deque[int]]:
        """What two moments, each with stamps of one series, have of a and of b."""
        return (self._free[left][0] or self._free[right][0], self._free[left][1] or self._free[right][1])

    def _remove(self, moment: int) -> None:
        before, after = self._before[moment], self._after[moment]
        if before >= 0:
            self._after[before] = after
        if after >= 0:
            self._before[after] = before
        self._after[moment] = -1
