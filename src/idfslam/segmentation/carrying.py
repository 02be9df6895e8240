"""Cells of a view carried into another one: where would it see what they show, if that stood still?"""

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.segmentation.coarse_view import CoarseView
from idfslam.segmentation.constants import NEVER
from idfslam.segmentation.free_space import intrinsics, seen_at
from idfslam.segmentation.plain_form import compiles

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]
Ages = NDArray[np.int32]
Depth = NDArray[np.float32]


# [frames] by which a cell is older beside the one that a point is seen in. More: masks creep less over what a body is near to, and follow
# it less. Chosen by hand on generated rooms.
BESIDE = 5


def carried(view: CoarseView, T: Array, cells: Cells, camera: Camera, T_wc: Array, *, ages: Ages | None = None) -> tuple[Depth, Ages]:
    """(h, w) [m] the depth at which a camera at a pose (4, 4) would see these cells of another posed view; infinite elsewhere.

    A cell covers 3 x 3 cells. And (h, w) the least ages [frames] of what is seen, `BESIDE` more beside the middle cell, `NEVER` elsewhere.
    ages: None: all are 0.
    """
    near, out = np.full((camera.height, camera.width), np.float32(np.inf)), np.full((camera.height, camera.width), NEVER, np.int32)
    if cells.any():
        carry = compiled_carry if compiles() else plain_carry
        carry(view, cells, np.zeros(cells.shape, np.int32) if ages is None else ages, camera, np.linalg.inv(T_wc) @ T, near, out)
    return near, out


def compiled_carry(view: CoarseView, cells: Cells, ages: Ages, camera: Camera, T_oc: Array, near: Depth, out: Ages) -> None:
    """`plain_carry` by Numba."""
    from idfslam.segmentation.kernels import numba_segmentation

    numba_segmentation.carry(cells, ages, BESIDE, view.depth, *intrinsics(view.camera, camera), T_oc, near, out)  # type: ignore[call-arg]


def plain_carry(view: CoarseView, cells: Cells, ages: Ages, camera: Camera, T_oc: Array, near: Depth, out: Ages) -> None:
    """Sets depths `near` and ages `out` (h, w) of the camera's cells, in numpy. T_oc (4, 4): of the view in the camera."""
    inside, row, column, r = seen_at(view, camera, T_oc)
    for v, u in np.argwhere(inside & cells):
        at = row[v, u], column[v, u]
        place = slice(max(at[0] - 1, 0), at[0] + 2), slice(max(at[1] - 1, 0), at[1] + 2)
        near[place] = np.minimum(near[place], r[v, u])
        out[place] = np.minimum(out[place], ages[v, u] + BESIDE)
        out[at] = min(out[at], ages[v, u])
