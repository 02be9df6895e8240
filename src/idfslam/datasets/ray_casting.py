"""Ray casting of boxes, frustums and ellipsoids, compiled with Numba.

A shape is a row of 17 numbers: kind, three sizes, centre (3) [m], rotation local-to-world (9, row-major), material.
Its local z axis is its own "up". Sizes: box - half edges; frustum - bottom radius, top radius, half height;
ellipsoid - three radii. The surface of a shape is unrolled into charts with coordinates (s, t) in [0, 1]: six
faces of a box (-x, +x, -y, +y, -z, +z), side, bottom and top of a frustum, the whole of an ellipsoid.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

BOX, FRUSTUM, ELLIPSOID = 0, 1, 2
CHARTS = 6  # the most that a shape has
_EPSILON = 1e-6  # [m] a ray does not hit the surface that it starts on
_LEAF = 2  # shapes in a leaf of the hierarchy


@dataclass(frozen=True)
class Hierarchy:
    """Bounding volumes in depth-first order: a ray that misses node i goes on at `skip[i]`."""

    bounds: NDArray[np.float64]
    """(B, 6) lowest and highest corner [m]."""
    skip: NDArray[np.int64]
    """(B,) the node after the subtree of node i."""
    first: NDArray[np.int64]
    """(B,) where a leaf's shapes start in `order`; -1: an inner node."""
    count: NDArray[np.int64]
    """(B,) shapes in the leaf."""
    order: NDArray[np.int64]
    """(P,) the shapes, leaf after leaf."""


def shape_bounds(shapes: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P, 17) shapes -> (P, 6) axis-aligned bounds [m]."""
    kind, R = shapes[:, 0], shapes[:, 7:16].reshape(-1, 3, 3)
    half = shapes[:, 1:4].copy()
    frustum = kind == FRUSTUM
    half[frustum, :2] = shapes[frustum, 1:3].max(1, keepdims=True)
    reach = np.einsum("pij,pj->pi", np.abs(R), half)
    round_reach = np.sqrt(np.einsum("pij,pj->pi", R**2, half**2))
    reach[kind == ELLIPSOID] = round_reach[kind == ELLIPSOID]
    return np.concatenate([shapes[:, 4:7] - reach, shapes[:, 4:7] + reach], 1)


def build_hierarchy(shapes: NDArray[np.float64]) -> Hierarchy:
    """A binary hierarchy over the shapes, split at the median of the longest side."""
    bounds = shape_bounds(shapes)
    centres = (bounds[:, :3] + bounds[:, 3:]) / 2
    nodes: list[tuple[NDArray[np.float64], int, int]] = []
    skip: list[int] = []
    order: list[int] = []

    def add(members: NDArray[np.int64]) -> None:
        index = len(nodes)
        box = np.concatenate([bounds[members, :3].min(0), bounds[members, 3:].max(0)])
        leaf = len(members) <= _LEAF
        nodes.append((box, len(order) if leaf else -1, len(members)))
        skip.append(0)
        if leaf:
            order.extend(members.tolist())
        else:
            axis = int(np.ptp(centres[members], axis=0).argmax())
            ranked = members[np.argsort(centres[members, axis], kind="stable")]
            add(ranked[: len(ranked) // 2])
            add(ranked[len(ranked) // 2 :])
        skip[index] = len(nodes)

    add(np.arange(len(shapes)))
    return Hierarchy(
        np.ascontiguousarray([n[0] for n in nodes]),
        np.array(skip),
        np.array([n[1] for n in nodes]),
        np.array([n[2] for n in nodes]),
        np.array(order),
    )


@njit(cache=True, nogil=True, inline="always")
def to_local(shape, x, y, z):
    """A direction of the world in the shape's axes (R^T d)."""
    return (
        shape[7] * x + shape[10] * y + shape[13] * z,
        shape[8] * x + shape[11] * y + shape[14] * z,
        shape[9] * x + shape[12] * y + shape[15] * z,
    )


@njit(cache=True, nogil=True, inline="always")
def to_world(shape, x, y, z):
    """A direction of the shape's axes in the world (R d)."""
    return (
        shape[7] * x + shape[8] * y + shape[9] * z,
        shape[10] * x + shape[11] * y + shape[12] * z,
        shape[13] * x + shape[14] * y + shape[15] * z,
    )


@njit(cache=True, nogil=True)
def _slab(o, inverse, low, high, near, far):
    """The part of a ray between two parallel planes."""
    a, b = (low - o) * inverse, (high - o) * inverse
    return max(near, min(a, b)), min(far, max(a, b))


@njit(cache=True, nogil=True)
def _hit_box(hx, hy, hz, ox, oy, oz, dx, dy, dz):
    near, far = _slab(ox, 1.0 / dx if dx != 0.0 else 1e30, -hx, hx, -np.inf, np.inf)
    near, far = _slab(oy, 1.0 / dy if dy != 0.0 else 1e30, -hy, hy, near, far)
    near, far = _slab(oz, 1.0 / dz if dz != 0.0 else 1e30, -hz, hz, near, far)
    if near > far or far < _EPSILON:
        return np.inf
    return near if near > _EPSILON else far


@njit(cache=True, nogil=True)
def _hit_ellipsoid(rx, ry, rz, ox, oy, oz, dx, dy, dz):
    ox, oy, oz, dx, dy, dz = ox / rx, oy / ry, oz / rz, dx / rx, dy / ry, dz / rz
    a = dx * dx + dy * dy + dz * dz
    b = ox * dx + oy * dy + oz * dz
    c = ox * ox + oy * oy + oz * oz - 1.0
    root = b * b - a * c
    if root < 0.0:
        return np.inf
    root = np.sqrt(root)
    if -b - root > a * _EPSILON:
        return (-b - root) / a
    return (-b + root) / a if -b + root > a * _EPSILON else np.inf


@njit(cache=True, nogil=True)
def _hit_frustum(r0, r1, h, ox, oy, oz, dx, dy, dz):
    """The side is x^2 + y^2 = (m + k z)^2 between z = -h and h; the caps are discs."""
    best = np.inf
    k, m = (r1 - r0) / (2.0 * h), (r0 + r1) / 2.0
    e, g = m + k * oz, k * dz
    a = dx * dx + dy * dy - g * g
    b = ox * dx + oy * dy - e * g
    root = b * b - a * (ox * ox + oy * oy - e * e)
    if root >= 0.0 and abs(a) > 1e-14:
        root = np.sqrt(root)
        for sign in (-1.0, 1.0):
            t = (-b + sign * root) / a
            if t > _EPSILON and t < best and abs(oz + t * dz) <= h:
                best = t
    if dz != 0.0:
        for sign in (-1.0, 1.0):
            t = (sign * h - oz) / dz
            x, y, r = ox + t * dx, oy + t * dy, r1 if sign > 0.0 else r0
            if t > _EPSILON and t < best and x * x + y * y <= r * r:
                best = t
    return best


@njit(cache=True, nogil=True)
def hit_shape(shape, ox, oy, oz, dx, dy, dz):
    """The ray's parameter at its first intersection with one shape; infinity: none."""
    px, py, pz = to_local(shape, ox - shape[4], oy - shape[5], oz - shape[6])
    qx, qy, qz = to_local(shape, dx, dy, dz)
    if shape[0] == BOX:
        return _hit_box(shape[1], shape[2], shape[3], px, py, pz, qx, qy, qz)
    if shape[0] == FRUSTUM:
        return _hit_frustum(shape[1], shape[2], shape[3], px, py, pz, qx, qy, qz)
    return _hit_ellipsoid(shape[1], shape[2], shape[3], px, py, pz, qx, qy, qz)


@njit(cache=True, nogil=True)
def cast(shapes, tree, ox, oy, oz, dx, dy, dz, limit):
    """First hit before `limit` along a ray: (parameter, shape), or (`limit`, -1). `tree` is a Hierarchy's five arrays."""
    bounds, skip, first, count, order = tree
    ix = 1.0 / dx if dx != 0.0 else 1e30
    iy = 1.0 / dy if dy != 0.0 else 1e30
    iz = 1.0 / dz if dz != 0.0 else 1e30
    best, found, node = limit, -1, 0
    while node < skip.shape[0]:
        a, b = (bounds[node, 0] - ox) * ix, (bounds[node, 3] - ox) * ix
        near, far = min(a, b), max(a, b)
        a, b = (bounds[node, 1] - oy) * iy, (bounds[node, 4] - oy) * iy
        near, far = max(near, min(a, b)), min(far, max(a, b))
        a, b = (bounds[node, 2] - oz) * iz, (bounds[node, 5] - oz) * iz
        near, far = max(near, min(a, b)), min(far, max(a, b))
        if near > far or far < 0.0 or near > best:
            node = skip[node]
            continue
        if first[node] >= 0:
            for i in range(first[node], first[node] + count[node]):
                t = hit_shape(shapes[order[i]], ox, oy, oz, dx, dy, dz)
                if t < best:
                    best, found = t, order[i]
        node += 1
    return best, found


@njit(cache=True, nogil=True)
def _box_surface(shape, x, y, z):
    a, b, c = abs(x) - shape[1], abs(y) - shape[2], abs(z) - shape[3]
    s, t, r = x / shape[1], y / shape[2], z / shape[3]
    if a >= b and a >= c:
        return (1 if x > 0 else 0), t / 2 + 0.5, r / 2 + 0.5, np.sign(x), 0.0, 0.0
    if b >= c:
        return (3 if y > 0 else 2), s / 2 + 0.5, r / 2 + 0.5, 0.0, np.sign(y), 0.0
    return (5 if z > 0 else 4), s / 2 + 0.5, t / 2 + 0.5, 0.0, 0.0, np.sign(z)


@njit(cache=True, nogil=True)
def _frustum_surface(shape, x, y, z):
    r0, r1, h = shape[1], shape[2], shape[3]
    k = (r1 - r0) / (2.0 * h)
    rho = np.sqrt(x * x + y * y)
    side = abs(rho - ((r0 + r1) / 2.0 + k * z)) / np.sqrt(1.0 + k * k)
    if h - abs(z) < side:
        r = r1 if z > 0 else r0
        return (2 if z > 0 else 1), x / (2 * r) + 0.5, y / (2 * r) + 0.5, 0.0, 0.0, np.sign(z)
    scale = 1.0 / (np.sqrt(1.0 + k * k) * max(rho, 1e-12))
    return 0, np.arctan2(y, x) / (2 * np.pi) + 0.5, z / (2 * h) + 0.5, x * scale, y * scale, -k / np.sqrt(1.0 + k * k)


@njit(cache=True, nogil=True)
def surface_at(shape, px, py, pz):
    """Chart, (s, t) and outward normal (world) of a point (world) on a shape's surface."""
    x, y, z = to_local(shape, px - shape[4], py - shape[5], pz - shape[6])
    if shape[0] == BOX:
        chart, s, t, nx, ny, nz = _box_surface(shape, x, y, z)
    elif shape[0] == FRUSTUM:
        chart, s, t, nx, ny, nz = _frustum_surface(shape, x, y, z)
    else:
        x, y, z = x / shape[1], y / shape[2], z / shape[3]
        chart, s, t = 0, np.arctan2(y, x) / (2 * np.pi) + 0.5, np.arcsin(min(max(z, -1.0), 1.0)) / np.pi + 0.5
        nx, ny, nz = x / shape[1], y / shape[2], z / shape[3]
        scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx * scale, ny * scale, nz * scale
    nx, ny, nz = to_world(shape, nx, ny, nz)
    return chart, s, t, nx, ny, nz


@njit(cache=True, nogil=True)
def point_on(shape, chart, s, t):
    """The point (world) at (s, t) of a chart: the inverse of `surface_at`."""
    u, v = 2 * s - 1, 2 * t - 1
    a, b, c = shape[1], shape[2], shape[3]
    if shape[0] == BOX:
        side = 1.0 if chart % 2 == 1 else -1.0
        if chart < 2:
            x, y, z = side * a, u * b, v * c
        elif chart < 4:
            x, y, z = u * a, side * b, v * c
        else:
            x, y, z = u * a, v * b, side * c
    elif shape[0] == FRUSTUM:
        r = (a * (1 - t) + b * t) if chart == 0 else (a if chart == 1 else b)
        x, y, z = np.cos(np.pi * u) * r, np.sin(np.pi * u) * r, v * c
        if chart > 0:
            x, y, z = u * r, v * r, (c if chart == 2 else -c)
    else:
        x, y, z = np.cos(np.pi * u) * np.cos(np.pi * v / 2) * a, np.sin(np.pi * u) * np.cos(np.pi * v / 2) * b, np.sin(np.pi * v / 2) * c
    x, y, z = to_world(shape, x, y, z)
    return x + shape[4], y + shape[5], z + shape[6]


@njit(cache=True, nogil=True)
def chart_size(shape, chart):
    """Extent (u, v) [m] of a chart; (0, 0): the shape does not have it."""
    a, b, c = 2 * shape[1], 2 * shape[2], 2 * shape[3]
    if shape[0] == BOX:
        return (b, c) if chart < 2 else ((a, c) if chart < 4 else (a, b))
    if shape[0] == FRUSTUM:
        if chart == 0:
            return np.pi * (a + b) / 2, c
        r = a if chart == 1 else b
        return (r, r) if chart < 3 else (0.0, 0.0)
    return (np.pi * (a + b) / 2, np.pi * c / 2) if chart == 0 else (0.0, 0.0)
