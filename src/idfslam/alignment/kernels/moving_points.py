"""Points that a moving camera sees row by row, for the kernels into which these functions are inlined."""

from numba import njit

from idfslam.alignment.constants import NEAREST

_FASTMATH = {"contract", "reassoc", "nsz", "arcp"}
_inlined = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", forceinline=True)  # why: numba_grid


@_inlined
def carry(x, y, z, s, velocity):  # type: ignore[no-untyped-def]
    """A point carried by a velocity (6,) for s seconds: exp(s velocity) p to second order, as `frame_motion.plain_carried` has it."""
    wx, wy, wz = velocity[3], velocity[4], velocity[5]
    a, b, c = wy * z - wz * y + velocity[0], wz * x - wx * z + velocity[1], wx * y - wy * x + velocity[2]
    half = s * s / 2
    return x + s * a + half * (wy * c - wz * b), y + s * b + half * (wz * a - wx * c), z + s * c + half * (wx * b - wy * a)


@_inlined
def numbers(R):  # type: ignore[no-untyped-def]
    """The numbers of R (3, 3), row by row. Unlike those of an array, a loop that fills arrays need not read them again at each step."""
    return R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2]


@_inlined
def along_axes(R, x, y, z):  # type: ignore[no-untyped-def]
    """A matrix of numbers R times a point."""
    return R[0] * x + R[1] * y + R[2] * z, R[3] * x + R[4] * y + R[5] * z, R[6] * x + R[7] * y + R[8] * z


@_inlined
def row_of(y, z, fy, cy, height):  # type: ignore[no-untyped-def]
    """The row that sees a point, from -0.5 at the top of the image to 0.5 at its bottom."""
    return min(max((y / max(z, NEAREST) * fy + cy + 0.5) / height, 0.0), 1.0) - 0.5
