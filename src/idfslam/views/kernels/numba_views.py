"""Warping, fusing and blending of archived images, compiled by Numba. The plain forms are in `warping.py` and `blending.py`."""

from typing import Any

import numpy as np
from numba import njit, prange

from idfslam.geometry.projection import project
from idfslam.sensing.depth_edges import EDGE, EDGE_SHARE
from idfslam.views.constants import AGREES, AGREES_SHARE, ANGLE, BORDER, COARSE, NEAREST, NEGLIGIBLE, SAME, SAME_SHARE, UNREAD

_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz", "arcp"}}
_parallel = njit(parallel=True, **_OPTIONS)
_inlined = njit(forceinline=True, **_OPTIONS)  # why: mapping/kernels/numba_grid

_ZERO, _ONE = np.float32(0), np.float32(1)
_EDGE, _EDGE_SHARE, _NEAREST = np.float32(EDGE), np.float32(EDGE_SHARE), np.float32(NEAREST)
_AGREES, _AGREES_SHARE, _SAME, _SAME_SHARE = (np.float32(x) for x in (AGREES, AGREES_SHARE, SAME, SAME_SHARE))
_ANGLE, _COARSE, _BORDER, _UNREAD = (np.float32(x) for x in (ANGLE, COARSE, BORDER, UNREAD))
_NEGLIGIBLE = np.float32(NEGLIGIBLE)
_INSIDE = np.float32(-1e-4)  # [1] least barycentric coordinate of a pixel in a triangle: edges between triangles leave no gaps


@_inlined
def _draw(x0, y0, z0, x1, y1, z1, x2, y2, z2, out):  # type: ignore[no-untyped-def]
    """Draws a triangle, seen from its front, into depth (H, W): pixels (x, y) and depths z of its corners, all in front of the camera."""
    left, right = max(_ZERO, np.ceil(min(x0, min(x1, x2)))), min(np.float32(out.shape[1] - 1), np.floor(max(x0, max(x1, x2))))
    top, bottom = max(_ZERO, np.ceil(min(y0, min(y1, y2)))), min(np.float32(out.shape[0] - 1), np.floor(max(y0, max(y1, y2))))
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    if area <= np.float32(1e-6):
        return
    q0, q1, q2 = _ONE / z0, _ONE / z1, _ONE / z2  # linear on the image
    for row in range(int(top), int(bottom) + 1):
        for column in range(int(left), int(right) + 1):
            b1 = ((column - x0) * (y2 - y0) - (x2 - x0) * (row - y0)) / area
            b2 = ((x1 - x0) * (row - y0) - (column - x0) * (y1 - y0)) / area
            b0 = _ONE - b1 - b2
            here = _ONE / (b0 * q0 + b1 * q1 + b2 * q2)
            if min(b0, min(b1, b2)) >= _INSIDE and (out[row, column] == _ZERO or here < out[row, column]):
                out[row, column] = here


@_inlined
def _is_surface(a, b, c):  # type: ignore[no-untyped-def]
    """Whether three neighbouring readings [m] lie on one surface."""
    low = min(a, min(b, c))
    return low > _ZERO and max(a, max(b, c)) - low <= _EDGE + _EDGE_SHARE * low


@_parallel
def warp(depths, intrinsics, T_vk, view, warped):  # type: ignore[no-untyped-def]
    """Draws the surfaces of K depth images (K, h, w) into warped (K, H, W), zero before: the nearest depth at each pixel of the view.

    T_vk (K, 3, 4): from the cameras of the images to that of the view. intrinsics, view: fx, fy, cx, cy.
    """
    K, h, w = depths.shape
    for k in prange(K):
        depth, out, T = depths[k], warped[k], T_vk[k]
        x, y, z = np.zeros((2, w), np.float32), np.zeros((2, w), np.float32), np.zeros((2, w), np.float32)
        for v in range(h):
            i, j = v & 1, 1 - (v & 1)  # this row, and that above
            for u in range(w):
                d = depth[v, u]
                point = ((u - intrinsics[2]) / intrinsics[0] * d, (v - intrinsics[3]) / intrinsics[1] * d, d)
                x[i, u], y[i, u], z[i, u] = project(T, point, (view[0], view[1], view[2], view[3]))
            for u in range(w - 1 if v > 0 else 0):
                n = u + 1
                a, b, c, d = depth[v - 1, u], depth[v - 1, n], depth[v, u], depth[v, n]
                middle = min(z[j, n], z[i, u]) >= _NEAREST
                if middle and z[j, u] >= _NEAREST and _is_surface(a, b, c):
                    _draw(x[j, u], y[j, u], z[j, u], x[j, n], y[j, n], z[j, n], x[i, u], y[i, u], z[i, u], out)
                if middle and z[i, n] >= _NEAREST and _is_surface(b, c, d):
                    _draw(x[j, n], y[j, n], z[j, n], x[i, n], y[i, n], z[i, n], x[i, u], y[i, u], z[i, u], out)


@_parallel
def fuse(warped, weights, depth):  # type: ignore[no-untyped-def]
    """Fills depth (H, W) with the mean of those of the K depths (K, H, W) of a pixel that most others agree with; 0 where there is none.

    weights (K,): of the images. Of surfaces that agree equally well the nearer one is taken.
    """
    K, H, W = warped.shape
    for v in prange(H):
        for u in range(W):
            best = _ZERO
            for k in range(K):
                z = warped[k, v, u]
                if z <= _ZERO:
                    continue
                within, weight, sum_ = _SAME + _SAME_SHARE * z * z, _ZERO, _ZERO
                for other in range(K):
                    off = (warped[other, v, u] - z) / within
                    if warped[other, v, u] > _ZERO and abs(off) < _ONE:
                        share = weights[other] * (_ONE - off * off)
                        weight += share
                        sum_ += share * warped[other, v, u]
                if weight / z > best:
                    best, depth[v, u] = weight / z, sum_ / weight


@_inlined
def weight_of_image(depth, off_edge, z, u, v, width, height, unread):  # type: ignore[no-untyped-def]
    """The weight of an image at its pixel (u, v), for a place at depth z [m] in it: 0 where something hides the place.

    depth, off_edge (h, w): its own depth [m], and its weight by the distance to silhouettes. unread: the weight without depth there.
    """
    border = min(min(u, width - 1 - u), min(v, height - 1 - v))
    if border < _ZERO:
        return _ZERO
    h, w = depth.shape
    column, row = min(int((u + np.float32(0.5)) * w / width), w - 1), min(int((v + np.float32(0.5)) * h / height), h - 1)
    if depth[row, column] < _ZERO:  # what moves
        return _ZERO
    fade, within = min(_ONE, (border + _ONE) / _BORDER) * off_edge[row, column], _AGREES + _AGREES_SHARE * z * z
    if depth[row, column] > _ZERO and abs(depth[row, column] - z) < within:  # so it is mostly: the pixels around need not be looked at
        return fade
    off = np.float32(np.inf)
    for i in range(max(row - 1, 0), min(row + 2, h)):
        for j in range(max(column - 1, 0), min(column + 2, w)):
            if depth[i, j] > _ZERO:
                off = min(off, abs(depth[i, j] - z))
    if off == np.inf:
        return fade * unread
    return fade if off < within else _ZERO


@_inlined
def sample(image, u, v, channel):  # type: ignore[no-untyped-def]
    """A channel of an image (H, W, 3) at (u, v), bilinear."""
    column, row = int(u), int(v)
    right, below = min(column + 1, image.shape[1] - 1), min(row + 1, image.shape[0] - 1)
    a, b = np.float32(u - column), np.float32(v - row)
    top = image[row, column, channel] * (_ONE - a) + image[row, right, channel] * a
    bottom = image[below, column, channel] * (_ONE - a) + image[below, right, channel] * a
    return top * (_ONE - b) + bottom * b


@_parallel
def blend(points, centre, colours, depths, off_edges, intrinsics, T_kw, centres, base, gains, offsets, colour, weights):  # type: ignore[no-untyped-def]
    """Fills colour (N, 3) with the weighted mean of the K images at points (N, 3) [m] in the world, and weights (N,) with the sums.

    Points that are not finite are left out. centre (3,): of the view. colours (K, H, W, 3) uint8; depths, off_edges (K, h, w): see
    `weight_of_image`. T_kw (K, 3, 4), centres (K, 3), base (K,): poses and weights of the images. gains, offsets (K, 3): to one exposure.
    """
    K, height, width = colours.shape[:3]
    for i in prange(len(points)):
        X, Y, Z = points[i, 0], points[i, 1], points[i, 2]
        weights[i] = _ZERO
        dx, dy, dz = X - centre[0], Y - centre[1], Z - centre[2]
        from_view = np.sqrt(dx * dx + dy * dy + dz * dz)
        if not from_view < np.inf:
            continue
        r, g, b, total = _ZERO, _ZERO, _ZERO, _ZERO
        for k in range(K):
            u, v, z = project(T_kw[k], (X, Y, Z), (intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]))
            if z < _NEAREST:
                continue
            ex, ey, ez = X - centres[k, 0], Y - centres[k, 1], Z - centres[k, 2]
            from_image = np.sqrt(ex * ex + ey * ey + ez * ez)
            cosine = (ex * dx + ey * dy + ez * dz) / (from_image * from_view)
            angle = np.sqrt(max(_ZERO, 2 * (_ONE - cosine))) + _COARSE * max(_ZERO, _ONE - from_view / from_image)
            most = base[k] * np.exp(-angle / _ANGLE)
            if most <= _NEGLIGIBLE * total:
                continue
            weight = most * weight_of_image(depths[k], off_edges[k], z, u, v, width, height, _UNREAD)
            if weight <= _ZERO:
                continue
            r += weight * (sample(colours[k], u, v, 0) * gains[k, 0] + offsets[k, 0])
            g += weight * (sample(colours[k], u, v, 1) * gains[k, 1] + offsets[k, 1])
            b += weight * (sample(colours[k], u, v, 2) * gains[k, 2] + offsets[k, 2])
            total += weight
        if total > _ZERO:
            colour[i, 0], colour[i, 1], colour[i, 2], weights[i] = r / total, g / total, b / total, total
