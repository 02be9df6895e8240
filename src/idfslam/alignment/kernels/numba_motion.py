"""Changes of poses on the CPU, compiled by Numba: a frame asks for forty of them. The plain forms are in `motion`."""

import math

import numpy as np
from numba import njit

from idfslam.alignment.constants import TINY

_compiled = njit(cache=True, nogil=True, error_model="numpy")


@_compiled
def move(T, change, out) -> None:  # type: ignore[no-untyped-def]
    """Fills out (4, 4), which may be T itself, with the pose T (4, 4) after a change (6,): `motion.plain_moved`."""
    x, y, z = change[3], change[4], change[5]
    angle = math.sqrt(x * x + y * y + z * z)
    a = math.sin(angle) / angle if angle > TINY else 1.0
    half = math.sin(angle / 2) / angle if angle > TINY else 0.5
    c = 2 * half * half
    p, q, r = c * x * y, c * x * z, c * y * z
    R = T[:3, :3].copy()
    for j in range(3):
        out[0, j] = R[0, j] - c * (y * y + z * z) * R[0, j] + (p - a * z) * R[1, j] + (q + a * y) * R[2, j]
        out[1, j] = R[1, j] + (p + a * z) * R[0, j] - c * (x * x + z * z) * R[1, j] + (r - a * x) * R[2, j]
        out[2, j] = R[2, j] + (q - a * y) * R[0, j] + (r + a * x) * R[1, j] - c * (x * x + y * y) * R[2, j]
    for i in range(3):
        out[i, 3] = T[i, 3] + change[i]
        out[3, i] = T[3, i]
    out[3, 3] = T[3, 3]


@_compiled
def change_to(T, other, change) -> float:  # type: ignore[no-untyped-def]
    """Fills change (6,) from a pose T (4, 4) to another one, and returns the cosine of its turn: `motion.plain_change_between`."""
    R = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            R[i, j] = other[i, 0] * T[j, 0] + other[i, 1] * T[j, 1] + other[i, 2] * T[j, 2]
        change[i] = other[i, 3] - T[i, 3]
    x, y, z = (R[2, 1] - R[1, 2]) / 2, (R[0, 2] - R[2, 0]) / 2, (R[1, 0] - R[0, 1]) / 2
    sine, cosine = math.sqrt(x * x + y * y + z * z), (R[0, 0] + R[1, 1] + R[2, 2] - 1) / 2
    scale = math.atan2(sine, cosine) / sine if sine > TINY else 1.0
    change[3], change[4], change[5] = scale * x, scale * y, scale * z
    return cosine
