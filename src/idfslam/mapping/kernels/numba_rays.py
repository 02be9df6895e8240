"""Pixels to rays to samples on the CPU, compiled by Numba. The plain forms are in `active_sampling.py`, `rays.py` and `ray_samples.py`.

A step of the map draws some thousand pixels. In torch each of the fifty small operations from pixels to samples costs more than its
arithmetic.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from idfslam.mapping.constants import FREE_FROM, FREE_TO, GRAZING
from idfslam.sensing.depth_edges import EDGE, EDGE_SHARE

Floats = NDArray[np.float32]

_compiled = njit(cache=True, nogil=True, error_model="numpy")
_inlined = njit(cache=True, nogil=True, error_model="numpy", forceinline=True)  # why: numba_grid

_EDGE, _EDGE_SHARE = np.float32(EDGE), np.float32(EDGE_SHARE)
_FREE_FROM, _FREE_TO, _GRAZING = np.float32(FREE_FROM), np.float32(FREE_TO), np.float32(GRAZING)
_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_SHORT = np.float32(1e-12)  # [m^2] length up to which a cross product counts as zero, and gives no normal


@_compiled
def group_pixels(allowed, cells, order, counts):  # type: ignore[no-untyped-def]
    """Fills `order` with v * width + u of the allowed pixels (H, W), sorted by cell, and counts (cells^2,); returns their number."""
    height, width = allowed.shape
    cell_u = np.empty(width, np.int64)
    for u in range(width):
        cell_u[u] = u * cells // width
    counts[:] = 0
    for v in range(height):
        row = v * cells // height * cells
        for u in range(width):
            counts[row + cell_u[u]] += allowed[v, u]
    place = np.empty(cells * cells, np.int64)
    total = 0
    for cell in range(cells * cells):
        place[cell] = total
        total += counts[cell]
    for v in range(height):
        row = v * cells // height * cells
        for u in range(width):
            if allowed[v, u]:
                cell = row + cell_u[u]
                order[place[cell]] = v * width + u
                place[cell] += 1
    return total


@_inlined
def _cos_incidence(depth: Floats, u: int, v: int, fx: np.float32, fy: np.float32, cx: np.float32, cy: np.float32, reach: int) -> np.float32:
    """|n . d| of the surface's normal and the ray of one pixel: `rays.cos_incidence`."""
    height, width = depth.shape
    left, right, up, down = max(u - reach, 0), min(u + reach, width - 1), max(v - reach, 0), min(v + reach, height - 1)
    here, l, r, a, b = depth[v, u], depth[v, left], depth[v, right], depth[up, u], depth[down, u]
    edge = _EDGE + _EDGE_SHARE * here
    if min(min(l, r), min(a, b)) <= _ZERO or max(max(abs(l - here), abs(r - here)), max(abs(a - here), abs(b - here))) >= edge:
        return _ONE
    x, y = (np.float32(u) - cx) / fx, (np.float32(v) - cy) / fy
    # The differences right - left and down - up, each of a point that is its depth times its ray
    hx = (np.float32(right) - cx) / fx * r - (np.float32(left) - cx) / fx * l
    hy, hz = y * (r - l), r - l
    kx, kz = x * (b - a), b - a
    ky = (np.float32(down) - cy) / fy * b - (np.float32(up) - cy) / fy * a
    nx, ny, nz = hy * kz - hz * ky, hz * kx - hx * kz, hx * ky - hy * kx
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if length <= _SHORT:
        return _ONE
    return max(abs(nx * x + ny * y + nz) / length, _GRAZING)


@_compiled
def cast(uv, depth, colour, fx, fy, cx, cy, R, reach, directions, ray_depth, ray_colour, ray_cosine) -> None:  # type: ignore[no-untyped-def]
    """Fills the rays, depths and colours of a view with rotation R (3, 3) at pixels uv (N, 2): `rays.cast`."""
    for n in range(len(uv)):
        u, v = uv[n, 0], uv[n, 1]
        x, y = (np.float32(u) - cx) / fx, (np.float32(v) - cy) / fy
        for axis in range(3):
            directions[n, axis] = R[axis, 0] * x + R[axis, 1] * y + R[axis, 2]
            ray_colour[n, axis] = colour[v, u, axis]
        ray_depth[n] = depth[v, u]
        ray_cosine[n] = _cos_incidence(depth, u, v, fx, fy, cx, cy, reach)


@_compiled
def place(origins, directions, depth, cos_incidence, jitter, free_jitter, truncation, points, target) -> None:  # type: ignore[no-untyped-def]
    """Fills points (B * (S + S'), 3) and target (B * (S + S'),) of S samples near the surface and S' in free space on B rays.

    jitter (B, S) and free_jitter (B, S') in [0, 1) place each sample in its stratum: `ray_samples.sample_points`.
    """
    rays, near = jitter.shape
    free = free_jitter.shape[1]
    for n in range(rays):
        z = depth[n]
        slope = cos_incidence[n] / truncation
        for s in range(near):
            at = z - truncation + _TWO * truncation * ((np.float32(s) + jitter[n, s]) / np.float32(near))
            k = n * near + s
            for axis in range(3):
                points[k, axis] = origins[n, axis] + directions[n, axis] * at
            target[k] = min(max((z - at) * slope, -_ONE), _ONE)
        first, last = _FREE_FROM, max(z - truncation, _FREE_TO)
        for s in range(free):
            at = first + (last - first) * ((np.float32(s) + free_jitter[n, s]) / np.float32(free))
            k = rays * near + n * free + s
            for axis in range(3):
                points[k, axis] = origins[n, axis] + directions[n, axis] * at
            target[k] = _ONE
