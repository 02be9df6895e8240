"""Cells of a view carried into another one: where would it see what they show, if that stood still?"""

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.segmentation.coarse_view import CoarseView
from idfslam.segmentation.free_space import intrinsics, seen_at
from idfslam.segmentation.plain_form import compiles

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]
Ages = NDArray[np.int32]
Depth = NDArray[np.float32]


def carried(view: CoarseView, T: Array, cells: Cells, camera: Camera, T_wc: Array, *, ages: Ages | None = None) -> tuple[Depth, Ages]:
    """(h, w) [m] the depth at which a camera at a pose (4, 4) would see these cells of another posed view; infinite elsewhere.

    A cell covers 3 x 3 cells. And (h, w) the ages of what is seen, 0 elsewhere; None: all are 0.
    """
    near, out = np.full((camera.height, camera.width), np.float32(np.inf)), np.zeros((camera.height, camera.width), np.int32)
    if cells.any():
        carry = compiled_carry if compiles() else plain_carry
        carry(view, cells, np.zeros(cells.shape, np.int32) if ages is None else ages, camera, np.linalg.inv(T_wc) @ T, near, out)
    return near, out


def compiled_carry(view: CoarseView, cells: Cells, ages: Ages, camera: Camera, T_oc: Array, near: Depth, out: Ages) -> None:
    """`plain_carry` by Numba."""
    from idfslam.segmentation.kernels import numba_segmentation

    numba_segmentation.carry(cells, ages, view.depth, *intrinsics(view.camera, camera), T_oc, near, out)  # type: ignore[call-arg]


def plain_carry(view: CoarseView, cells: Cells, ages: Ages, camera: Camera, T_oc: Array, near: Depth, out: Ages) -> None:
    """Sets depths `near` and ages `out` (h, w) of the camera's cells, in numpy. T_oc (4, 4): of the view in the camera."""
    inside, row, column, r = seen_at(view, camera, T_oc)
    for v, u in np.argwhere(inside & cells):
        place = slice(max(row[v, u] - 1, 0), row[v, u] + 2), slice(max(column[v, u] - 1, 0), column[v, u] + 2)
        nearer = r[v, u] < near[place]
        near[place][nearer], out[place][nearer] = r[v, u], ages[v, u]
