"""The colours of points of a surface in one image, compiled by Numba."""

import numpy as np
from numba import njit, prange

from idfslam.geometry.projection import project
from idfslam.views.constants import LEAST_COSINE, NEAREST, SHARPNESS
from idfslam.views.kernels.numba_views import sample, weight_of_image

_NEAREST, _LEAST_COSINE = np.float32(NEAREST), np.float32(LEAST_COSINE)
_ZERO, _ONE = np.float32(0), np.float32(1)


@njit(cache=True, nogil=True, parallel=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})  # type: ignore[untyped-decorator]
def gather(points, normals, T_cw, centre, intrinsics, colour, depth, off_edge, gain, offset, expected, scale, total, weights):  # type: ignore[no-untyped-def]
    """Adds the weighted colours of points (N, 3), with normals (N, 3), in one image to total (N, 3), and the weights to weights (N,).

    T_cw (3, 4), centre (3,): its pose. colour (H, W, 3); depth, off_edge (h, w): see `weight_of_image`. gain * colour + offset is compared
    with expected (N, 3): what differs by `scale` counts half.
    """
    height, width = colour.shape[:2]
    for i in prange(len(points)):
        u, v, z = project(T_cw, points[i], (intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]))
        if z < _NEAREST:
            continue
        dx, dy, dz = centre[0] - points[i, 0], centre[1] - points[i, 1], centre[2] - points[i, 2]
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        cosine = (dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]) / distance
        if cosine < _LEAST_COSINE:
            continue
        weight = weight_of_image(depth, off_edge, z, u, v, width, height, _ZERO)
        if weight <= _ZERO:
            continue
        r = sample(colour, u, v, 0) * gain[0] + offset[0]
        g = sample(colour, u, v, 1) * gain[1] + offset[1]
        b = sample(colour, u, v, 2) * gain[2] + offset[2]
        off = ((r - expected[i, 0]) ** 2 + (g - expected[i, 1]) ** 2 + (b - expected[i, 2]) ** 2) / (scale * scale)
        weight *= (cosine / distance) ** SHARPNESS / (_ONE + off)
        total[i, 0] += weight * r
        total[i, 1] += weight * g
        total[i, 2] += weight * b
        weights[i] += weight
