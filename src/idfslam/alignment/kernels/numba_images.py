"""Images on the CPU, compiled by Numba: their brightness, their slopes, and where these are steepest.

The plain forms are in the modules that call these.
"""

import numpy as np
from numba import njit

from idfslam.sensing.depth_edges import EDGE, EDGE_SHARE

_EDGE, _EDGE_SHARE = np.float32(EDGE), np.float32(EDGE_SHARE)
_FASTMATH = {"contract", "reassoc", "nsz", "arcp"}
_compiled = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy")
_inlined = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", forceinline=True)  # why: numba_grid


@_compiled
def luminance_of(colour, out) -> None:  # type: ignore[no-untyped-def]
    """Fills out (H, W) with the means of colour (H, W, 3)."""
    channels, means = colour.reshape(-1), out.reshape(-1)  # in one dimension the loop vectorises
    for i in range(len(means)):
        means[i] = (channels[3 * i] + channels[3 * i + 1] + channels[3 * i + 2]) * np.float32(1 / 3)


@_compiled
def sampled(image, uv, out) -> None:  # type: ignore[no-untyped-def]
    """Fills out (3, N) with an image (h, w) and its slopes at pixels (N, 2): `image_pyramid.plain_sampled`."""
    h, w = image.shape
    zero, one = np.float32(0), np.float32(1)
    for n in range(len(uv)):
        u, v = min(max(uv[n, 0], zero), np.float32(w - 1)), min(max(uv[n, 1], zero), np.float32(h - 1))
        left, top = min(int(u), w - 2), min(int(v), h - 2)
        a, c = u - np.float32(left), v - np.float32(top)
        value, along_u, along_v = zero, zero, zero
        for y, share_y in ((top, one - c), (top + 1, c)):
            for x, share_x in ((left, one - a), (left + 1, a)):
                share = share_x * share_y
                value += share * image[y, x]
                if 0 < x < w - 1:
                    along_u += share * (image[y, x + 1] - image[y, x - 1]) / 2
                if 0 < y < h - 1:
                    along_v += share * (image[y + 1, x] - image[y - 1, x]) / 2
        out[0, n], out[1, n], out[2, n] = value, along_u, along_v


@_compiled
def steepest(image, depth, cell, least, u, v) -> int:  # type: ignore[no-untyped-def]
    """Fills u and v with the pixel of the largest gradient in each cell of an image (h, w), if that is above `least` [1/px].

    Returns their number. The pixel and its neighbours have depth (H, W) [m], with no edge between them: `landmarks.plain_steepest`.
    """
    h, w = image.shape
    found = 0
    rows, columns = np.empty(h, np.int64), np.empty(w, np.int64)
    for y in range(h):
        rows[y] = int((np.float32(y) + np.float32(0.5)) * np.float32(depth.shape[0]) / np.float32(h))
    for x in range(w):
        columns[x] = int((np.float32(x) + np.float32(0.5)) * np.float32(depth.shape[1]) / np.float32(w))
    for top in range(0, h // cell * cell, cell):
        for left in range(0, w // cell * cell, cell):
            best, best_x, best_y = least * least, -1, -1
            for y in range(top, top + cell):
                for x in range(left, left + cell):
                    a = (image[y, x + 1] - image[y, x - 1]) / 2 if 0 < x < w - 1 else np.float32(0)
                    b = (image[y + 1, x] - image[y - 1, x]) / 2 if 0 < y < h - 1 else np.float32(0)
                    if a * a + b * b > best and _on_one_surface(depth, rows, columns, x, y):
                        best, best_x, best_y = a * a + b * b, x, y
            if best_x >= 0:
                u[found], v[found] = best_x, best_y
                found += 1
    return found


@_inlined
def _on_one_surface(depth, rows, columns, x, y) -> bool:  # type: ignore[no-untyped-def]
    """Whether a pixel and its eight neighbours have depth, and none is much nearer or farther."""
    nearest, farthest = np.float32(np.inf), np.float32(0)
    for j in range(max(y - 1, 0), min(y + 2, len(rows))):
        for i in range(max(x - 1, 0), min(x + 2, len(columns))):
            z = depth[rows[j], columns[i]]
            nearest, farthest = min(nearest, z), max(farthest, z)
    return nearest > 0 and farthest - nearest < _EDGE + _EDGE_SHARE * nearest
