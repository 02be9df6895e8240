"""Ray casting against boxes, frustums and ellipsoids, compiled with Numba.

A shape is a row of 17 numbers: kind, three sizes, centre (3) [m], rotation local-to-world (9, row-major), material.
Its local z axis is its own "up". Sizes: box - half edges; frustum - bottom radius, top radius, half height;
ellipsoid - three radii. The surface of a shape is unrolled into charts with coordinates (s, t) in [0, 1]: six
faces of a box (-x, +x, -y, +y, -z, +z), side, bottom and top of a frustum, the whole of an ellipsoid.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"nsz"}}
"""Without Python's check of every division. Sums keep the written order, so that every process renders a room equal to the bit."""
compiled = njit(**OPTIONS)

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
Surface = tuple[int, float, float, float, float, float]  # chart, s, t, normal

BOX, FRUSTUM, ELLIPSOID = 0, 1, 2
CHARTS = 6  # largest number of charts of a shape
_EPSILON = 1e-6  # [1] smallest parameter of a hit along a ray, so that a ray does not hit the surface that it starts on


def shape_bounds(shapes: Array) -> Array:
    """Axis-aligned bounds (P, 6) [m] of shapes (P, 17): lowest and highest corner."""
    kind, R = shapes[:, 0], shapes[:, 7:16].reshape(-1, 3, 3)
    half = shapes[:, 1:4].copy()
    frustum = kind == FRUSTUM
    half[frustum, :2] = shapes[frustum, 1:3].max(1, keepdims=True)
    reach = np.einsum("pij,pj->pi", np.abs(R), half)
    round_reach = np.sqrt(np.einsum("pij,pj->pi", R**2, half**2))
    reach[kind == ELLIPSOID] = round_reach[kind == ELLIPSOID]
    return np.concatenate([shapes[:, 4:7] - reach, shapes[:, 4:7] + reach], 1)


def build_hierarchy(shapes: Array) -> Array:
    """The bounding volume hierarchy of the shapes: a binary tree, split by the surface area heuristic, in depth-first order.

    Each row of (2 P - 1, 8) is a node: lowest and highest corner [m], the node after its subtree, its shape (-1: an inner node).
    """
    bounds = shape_bounds(shapes)
    nodes: list[list[float]] = []

    def add(members: NDArray[np.int64]) -> None:
        node = [*bounds[members, :3].min(0), *bounds[members, 3:].max(0), 0.0, float(members[0]) if len(members) == 1 else -1.0]
        nodes.append(node)
        if len(members) > 1:
            for part in _split(members, bounds):
                add(part)
        node[6] = float(len(nodes))

    add(np.arange(len(shapes)))
    return np.array(nodes)


def _split(members: NDArray[np.int64], bounds: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Splits at the axis and position with the smallest sum of surface area times number of shapes: few rays then enter both parts."""

    def areas(ranked: Array) -> Array:
        x, y, z = (np.maximum.accumulate(ranked[:, 3:]) - np.minimum.accumulate(ranked[:, :3])).T
        return x * y + y * z + z * x

    best, halves = np.inf, (members, members)
    for axis in range(3):
        ranked = members[np.argsort(bounds[members, axis] + bounds[members, axis + 3], kind="stable")]
        count = np.arange(1, len(ranked))
        cost = areas(bounds[ranked])[:-1] * count + areas(bounds[ranked[::-1]])[-2::-1] * count[::-1]
        at = int(cost.argmin())
        if cost[at] < best:
            best, halves = cost[at], (ranked[: at + 1], ranked[at + 1 :])
    return halves


@compiled
def to_local(shapes: Array, i: int, x: float, y: float, z: float) -> Vector:
    """A direction of the world in the shape's axes (R^T d)."""
    return (
        shapes[i, 7] * x + shapes[i, 10] * y + shapes[i, 13] * z,
        shapes[i, 8] * x + shapes[i, 11] * y + shapes[i, 14] * z,
        shapes[i, 9] * x + shapes[i, 12] * y + shapes[i, 15] * z,
    )


@compiled
def to_world(shapes: Array, i: int, x: float, y: float, z: float) -> Vector:
    """A direction of the shape's axes in the world (R d)."""
    return (
        shapes[i, 7] * x + shapes[i, 8] * y + shapes[i, 9] * z,
        shapes[i, 10] * x + shapes[i, 11] * y + shapes[i, 12] * z,
        shapes[i, 13] * x + shapes[i, 14] * y + shapes[i, 15] * z,
    )


@compiled
def _slab(o: float, inverse: float, low: float, high: float, near: float, far: float) -> tuple[float, float]:
    """The interval of the ray's parameter between two parallel planes, within [near, far]."""
    a, b = (low - o) * inverse, (high - o) * inverse
    return max(near, min(a, b)), min(far, max(a, b))


@compiled
def _hit_box(hx: float, hy: float, hz: float, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> float:
    near, far = _slab(ox, 1.0 / dx if dx != 0.0 else 1e30, -hx, hx, -np.inf, np.inf)
    near, far = _slab(oy, 1.0 / dy if dy != 0.0 else 1e30, -hy, hy, near, far)
    near, far = _slab(oz, 1.0 / dz if dz != 0.0 else 1e30, -hz, hz, near, far)
    if near > far or far < _EPSILON:
        return np.inf
    return near if near > _EPSILON else far


@compiled
def _hit_ellipsoid(rx: float, ry: float, rz: float, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> float:
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


@compiled
def _hit_frustum(r0: float, r1: float, h: float, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> float:
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


@compiled
def hit_shape(shapes: Array, i: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> float:
    """The ray's parameter at its first hit of one shape; infinity: none."""
    px, py, pz = to_local(shapes, i, ox - shapes[i, 4], oy - shapes[i, 5], oz - shapes[i, 6])
    qx, qy, qz = to_local(shapes, i, dx, dy, dz)
    if shapes[i, 0] == BOX:
        return _hit_box(shapes[i, 1], shapes[i, 2], shapes[i, 3], px, py, pz, qx, qy, qz)
    if shapes[i, 0] == FRUSTUM:
        return _hit_frustum(shapes[i, 1], shapes[i, 2], shapes[i, 3], px, py, pz, qx, qy, qz)
    return _hit_ellipsoid(shapes[i, 1], shapes[i, 2], shapes[i, 3], px, py, pz, qx, qy, qz)


@njit(
    "Tuple((float64, int64))(float64[:, ::1], float64[:, ::1], " + "float64, " * 7 + "int64)", **OPTIONS
)  # one version, also for a literal hint
def cast(
    shapes: Array, nodes: Array, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, limit: float, hint: int
) -> tuple[float, int]:
    """The first hit before `limit` along a ray: (parameter, shape), or (`limit`, -1). `nodes` is the hierarchy.

    `hint` is a shape that is likely to be hit, such as that of the pixel beside (-1: none); testing it first saves most of the search.
    """
    ix = 1.0 / dx if dx != 0.0 else 1e30
    iy = 1.0 / dy if dy != 0.0 else 1e30
    iz = 1.0 / dz if dz != 0.0 else 1e30
    best, found, node = limit, -1, 0
    if hint >= 0:
        t = hit_shape(shapes, hint, ox, oy, oz, dx, dy, dz)
        if t < best:
            best, found = t, hint
    while node < nodes.shape[0]:
        a, b = (nodes[node, 0] - ox) * ix, (nodes[node, 3] - ox) * ix
        near, far = min(a, b), max(a, b)
        a, b = (nodes[node, 1] - oy) * iy, (nodes[node, 4] - oy) * iy
        near, far = max(near, min(a, b)), min(far, max(a, b))
        a, b = (nodes[node, 2] - oz) * iz, (nodes[node, 5] - oz) * iz
        near, far = max(near, min(a, b)), min(far, max(a, b))
        if near > far or far < 0.0 or near > best:
            node = int(nodes[node, 6])
            continue
        i = int(nodes[node, 7])
        if i >= 0 and i != hint:
            t = hit_shape(shapes, i, ox, oy, oz, dx, dy, dz)
            if t < best:
                best, found = t, i
        node += 1
    return best, found


@compiled
def prune(nodes: Array, poses: Array, corners: Array, out: Array) -> int:
    """Finds the leaves that rays from any of the cameras `poses` (B, 4, 4), each between four `corners` (B, 4, 3), can hit.

    Returns their number. `corners` are directions in the world, clockwise as the camera sees them. The rows written to `out` (2 P - 1, 8)
    are a flat hierarchy, small enough to stay in the first-level cache while a tile of the image is cast.
    """
    planes, count, node = np.empty((corners.shape[0], 4, 3)), 0, 0
    for band in range(corners.shape[0]):
        for k in range(4):
            a, b = corners[band, k], corners[band, (k + 1) % 4]
            planes[band, k, 0], planes[band, k, 1] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2]
            planes[band, k, 2] = a[0] * b[1] - a[1] * b[0]
    while node < nodes.shape[0]:
        if not _seen_by_any(nodes[node], planes, poses):
            node = int(nodes[node, 6])
            continue
        if nodes[node, 7] >= 0:
            for k in range(6):
                out[count, k] = nodes[node, k]
            out[count, 6], out[count, 7] = count + 1, nodes[node, 7]
            count += 1
        node += 1
    return count


@compiled
def _seen_by_any(box: Array, planes: Array, poses: Array) -> bool:
    """Whether any of the cameras (B, 4, 4) may see a box between its planes (B, K, 3)."""
    band = 0
    while band < planes.shape[0] and _outside(box, planes[band], poses[band]):
        band += 1
    return band < planes.shape[0]


@compiled
def _outside(box: Array, planes: Array, T: Array) -> bool:
    """Whether a box lies completely on the outer side of one of the planes (K, 3) through the camera's centre."""
    for k in range(planes.shape[0]):
        reach = 0.0
        for axis in range(3):
            normal = planes[k, axis]
            reach += normal * ((box[axis + 3] if normal > 0.0 else box[axis]) - T[axis, 3])
        if reach < 0.0:
            return True
    return False


@compiled
def _box_surface(shapes: Array, i: int, x: float, y: float, z: float) -> Surface:
    a, b, c = abs(x) - shapes[i, 1], abs(y) - shapes[i, 2], abs(z) - shapes[i, 3]
    s, t, r = x / shapes[i, 1], y / shapes[i, 2], z / shapes[i, 3]
    if a >= b and a >= c:
        return (1 if x > 0 else 0), t / 2 + 0.5, r / 2 + 0.5, np.sign(x), 0.0, 0.0
    if b >= c:
        return (3 if y > 0 else 2), s / 2 + 0.5, r / 2 + 0.5, 0.0, np.sign(y), 0.0
    return (5 if z > 0 else 4), s / 2 + 0.5, t / 2 + 0.5, 0.0, 0.0, np.sign(z)


@compiled
def _frustum_surface(shapes: Array, i: int, x: float, y: float, z: float) -> Surface:
    r0, r1, h = shapes[i, 1], shapes[i, 2], shapes[i, 3]
    k = (r1 - r0) / (2.0 * h)
    rho = np.sqrt(x * x + y * y)
    side = abs(rho - ((r0 + r1) / 2.0 + k * z)) / np.sqrt(1.0 + k * k)
    if h - abs(z) < side:
        r = r1 if z > 0 else r0
        return (2 if z > 0 else 1), x / (2 * r) + 0.5, y / (2 * r) + 0.5, 0.0, 0.0, np.sign(z)
    scale = 1.0 / (np.sqrt(1.0 + k * k) * max(rho, 1e-12))
    return 0, np.arctan2(y, x) / (2 * np.pi) + 0.5, z / (2 * h) + 0.5, x * scale, y * scale, -k / np.sqrt(1.0 + k * k)


@compiled
def surface_at(shapes: Array, i: int, px: float, py: float, pz: float) -> Surface:
    """Chart, (s, t) and outward normal (world) of a point (world) on a shape's surface."""
    x, y, z = to_local(shapes, i, px - shapes[i, 4], py - shapes[i, 5], pz - shapes[i, 6])
    if shapes[i, 0] == BOX:
        chart, s, t, nx, ny, nz = _box_surface(shapes, i, x, y, z)
    elif shapes[i, 0] == FRUSTUM:
        chart, s, t, nx, ny, nz = _frustum_surface(shapes, i, x, y, z)
    else:
        x, y, z = x / shapes[i, 1], y / shapes[i, 2], z / shapes[i, 3]
        chart, s, t = 0, np.arctan2(y, x) / (2 * np.pi) + 0.5, np.arcsin(min(max(z, -1.0), 1.0)) / np.pi + 0.5
        nx, ny, nz = x / shapes[i, 1], y / shapes[i, 2], z / shapes[i, 3]
        scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx * scale, ny * scale, nz * scale
    nx, ny, nz = to_world(shapes, i, nx, ny, nz)
    return chart, s, t, nx, ny, nz


@compiled
def point_on(shapes: Array, i: int, chart: int, s: float, t: float) -> Vector:
    """The point (world) at (s, t) of a chart: the inverse of `surface_at`."""
    u, v = 2 * s - 1, 2 * t - 1
    a, b, c = shapes[i, 1], shapes[i, 2], shapes[i, 3]
    if shapes[i, 0] == BOX:
        side = 1.0 if chart % 2 == 1 else -1.0
        if chart < 2:
            x, y, z = side * a, u * b, v * c
        elif chart < 4:
            x, y, z = u * a, side * b, v * c
        else:
            x, y, z = u * a, v * b, side * c
    elif shapes[i, 0] == FRUSTUM:
        r = (a * (1 - t) + b * t) if chart == 0 else (a if chart == 1 else b)
        x, y, z = np.cos(np.pi * u) * r, np.sin(np.pi * u) * r, v * c
        if chart > 0:
            x, y, z = u * r, v * r, (c if chart == 2 else -c)
    else:
        x, y, z = np.cos(np.pi * u) * np.cos(np.pi * v / 2) * a, np.sin(np.pi * u) * np.cos(np.pi * v / 2) * b, np.sin(np.pi * v / 2) * c
    x, y, z = to_world(shapes, i, x, y, z)
    return x + shapes[i, 4], y + shapes[i, 5], z + shapes[i, 6]


@compiled
def chart_size(shapes: Array, i: int, chart: int) -> tuple[float, float]:
    """Extent (u, v) [m] of a chart; (0, 0): the shape does not have it."""
    a, b, c = 2 * shapes[i, 1], 2 * shapes[i, 2], 2 * shapes[i, 3]
    if shapes[i, 0] == BOX:
        return (b, c) if chart < 2 else ((a, c) if chart < 4 else (a, b))
    if shapes[i, 0] == FRUSTUM:
        if chart == 0:
            return np.pi * (a + b) / 2, c
        r = a if chart == 1 else b
        return (r, r) if chart < 3 else (0.0, 0.0)
    return (np.pi * (a + b) / 2, np.pi * c / 2) if chart == 0 else (0.0, 0.0)
