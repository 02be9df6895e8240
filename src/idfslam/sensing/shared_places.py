"""The places of an image that another image sees too, compiled by Numba; `light_estimation.plain_shared` is its form in torch."""

import numpy as np
from numba import njit

from idfslam.sensing.depth_edges import EDGE, EDGE_SHARE


@njit(cache=True, nogil=True, error_model="numpy")
def fill_shared(places, T_ba, intrinsics, image, a, b, powers_a, powers_b, noise) -> int:  # type: ignore[no-untyped-def]
    """Fills colours a, b (N, 3), `even_powers` of both (N, K) and the noise (N,) of places that image b sees; returns their number.

    places: points (N, 3) [m] along the axes of camera a, colours (N, 3), powers (N, K) and standard deviations (N,). T_ba (4, 4).
    image: the colour (3, h, w), depth (h, w) [m] and standard deviations (h, w) of b. intrinsics: fx, fy, cx, cy of b [px].
    """
    points, colour, powers, uncertainty = places
    fx, fy, cx, cy = intrinsics
    of_b, depth, uncertainty_b = image
    height, width = depth.shape
    per_r2, found = 4 / np.float32(width**2 + height**2), 0
    for n in range(len(points)):
        x, y, z = points[n]
        z_b = T_ba[2, 0] * x + T_ba[2, 1] * y + T_ba[2, 2] * z + T_ba[2, 3]
        if not z_b > 0:
            continue
        u = (T_ba[0, 0] * x + T_ba[0, 1] * y + T_ba[0, 2] * z + T_ba[0, 3]) / z_b * fx + cx
        v = (T_ba[1, 0] * x + T_ba[1, 1] * y + T_ba[1, 2] * z + T_ba[1, 3]) / z_b * fy + cy
        if not (u >= -0.5 and u < width - 0.5 and v >= -0.5 and v < height - 0.5):
            continue
        row, column = min(int(np.rint(v)), height - 1), min(int(np.rint(u)), width - 1)
        if not abs(depth[row, column] - z_b) < EDGE + EDGE_SHARE * z_b:
            continue
        r2 = ((u - cx) ** 2 + (v - cy) ** 2) * per_r2
        power = r2
        for k in range(powers.shape[1]):
            powers_a[found, k], powers_b[found, k] = powers[n, k], power
            power *= r2
        u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
        left, top = min(int(u), width - 2), min(int(v), height - 2)
        s, t = u - left, v - top
        for k in range(3):
            upper = of_b[k, top, left] * (1 - s) + of_b[k, top, left + 1] * s
            lower = of_b[k, top + 1, left] * (1 - s) + of_b[k, top + 1, left + 1] * s
            a[found, k], b[found, k] = colour[n, k], upper * (1 - t) + lower * t
        noise[found] = np.sqrt(uncertainty[n] ** 2 + uncertainty_b[row, column] ** 2)
        found += 1
    return found
