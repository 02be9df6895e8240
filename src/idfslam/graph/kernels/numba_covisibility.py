"""Covisibility on the CPU, compiled by Numba. The plain form is in `covisibility.py`.

Each new keyframe is compared with all stored ones: thousands of points by hundreds of views. In torch they would pass through memory ten
times.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})  # type: ignore[untyped-decorator]
def in_view(x, y, z, sides, counts):  # type: ignore[no-untyped-def]
    """Fills counts (K,) with the number of the N points inside the viewing frustum of each of K views, given by five planes (K, 5, 4).

    A point is inside a plane (a, b, c, d) if a x + b y + c z + d >= 0. For the last one, the camera's own plane, it must be > 0.
    """
    zero = np.float32(0)
    for k in range(len(sides)):
        left, right, top, bottom, front = sides[k, 0], sides[k, 1], sides[k, 2], sides[k, 3], sides[k, 4]
        count = np.int32(0)
        for n in range(len(x)):
            inside = left[0] * x[n] + left[1] * y[n] + left[2] * z[n] + left[3] >= zero
            inside &= right[0] * x[n] + right[1] * y[n] + right[2] * z[n] + right[3] >= zero
            inside &= top[0] * x[n] + top[1] * y[n] + top[2] * z[n] + top[3] >= zero
            inside &= bottom[0] * x[n] + bottom[1] * y[n] + bottom[2] * z[n] + bottom[3] >= zero
            inside &= front[0] * x[n] + front[1] * y[n] + front[2] * z[n] + front[3] > zero
            count += np.int32(inside)
        counts[k] = count
