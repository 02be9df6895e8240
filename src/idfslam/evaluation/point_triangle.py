"""Distance from a point to a triangle (after Ericson, Real-Time Collision Detection, 5.1.5), compiled with Numba."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_compiled = njit(cache=True, nogil=True, error_model="numpy")


@_compiled
def nearest_triangle(points: Floats, triangles: Floats, candidates: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64]]:
    """Distances [m] from points (N, 3) to the nearest of their candidate triangles, and which that is, (N,) each.

    candidates: (N, K) indices into triangles (T, 3, 3) [m].
    """
    distance, nearest = np.empty(len(points)), np.empty(len(points), np.int64)
    for i in range(len(points)):
        best = np.inf
        for k in candidates[i]:
            square = _to_triangle(points[i], triangles[k, 0], triangles[k, 1], triangles[k, 2])
            if square < best:
                best, nearest[i] = square, k
        distance[i] = np.sqrt(best)
    return distance, nearest


@_compiled
def _to_triangle(p: Floats, a: Floats, b: Floats, c: Floats) -> float:
    """Squared distance from p to a triangle: to its face if the foot of p lies inside it, else to the nearest edge."""
    nearest = min(_to_edge(p, a, b), _to_edge(p, b, c), _to_edge(p, c, a))
    d1, d2 = _dot(a, b, a, p), _dot(a, c, a, p)
    d3, d4 = _dot(a, b, b, p), _dot(a, c, b, p)
    d5, d6 = _dot(a, b, c, p), _dot(a, c, c, p)
    u, v, w = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2  # barycentric coordinates of p's foot, not normalised
    return min(nearest, _square(p, a, b, c, v / (u + v + w), w / (u + v + w))) if u > 0 and v > 0 and w > 0 else nearest


@_compiled
def _to_edge(p: Floats, a: Floats, b: Floats) -> float:
    length = _dot(a, b, a, b)
    return _square(p, a, b, a, min(max(_dot(a, b, a, p) / length, 0.0), 1.0) if length > 0 else 0.0, 0.0)


@_compiled
def _dot(a: Floats, b: Floats, c: Floats, d: Floats) -> float:
    """(b - a) . (d - c)."""
    return (b[0] - a[0]) * (d[0] - c[0]) + (b[1] - a[1]) * (d[1] - c[1]) + (b[2] - a[2]) * (d[2] - c[2])


@_compiled
def _square(p: Floats, a: Floats, b: Floats, c: Floats, s: float, t: float) -> float:
    """Squared distance from p to a + s (b - a) + t (c - a)."""
    square = 0.0
    for j in range(3):
        square += (p[j] - a[j] - s * (b[j] - a[j]) - t * (c[j] - a[j])) ** 2
    return square
