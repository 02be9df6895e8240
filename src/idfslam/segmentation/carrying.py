"""Cells of a view carried into another one: where would it see what they show, if that stood still?"""

from typing import Any

import cv2
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


_AROUND = np.ones((3, 3), np.uint8)  # the cells that one covers where it is seen


def carried(view: CoarseView, T: Array, cells: Cells, camera: Camera, T_wc: Array) -> Depth:
    """(h, w) [m] the depth at which a camera at a pose (4, 4) would see these cells of another posed view; infinite elsewhere.

    A cell covers 3 x 3 cells.
    """
    return _spread(_middles(view, T, cells, np.zeros(cells.shape, np.int32), camera, T_wc)[0])


def carried_with_ages(view: CoarseView, T: Array, cells: Cells, ages: Ages, camera: Camera, T_wc: Array) -> tuple[Depth, Ages]:
    """`carried`, and (h, w) the least ages [frames] of what is seen, `BESIDE` more beside the middle cell, `NEVER` elsewhere."""
    near, out = _middles(view, T, cells, ages, camera, T_wc)
    return _spread(near), np.minimum(out, _spread(out.astype(np.float64)) + BESIDE).astype(np.int32)


def _middles(view: CoarseView, T: Array, cells: Cells, ages: Ages, camera: Camera, T_wc: Array) -> tuple[Depth, Ages]:
    """Depths and ages of `carried_with_ages` in the cells in which points are seen."""
    near, out = np.full((camera.height, camera.width), np.float32(np.inf)), np.full((camera.height, camera.width), NEVER, np.int32)
    if cells.any():
        carry = compiled_carry if compiles() else plain_carry
        carry(view, cells, ages, camera, np.linalg.inv(T_wc) @ T, near, out)
    return near, out


def _spread(least: NDArray[Any]) -> NDArray[Any]:
    """(h, w) the least within 3 x 3 cells."""
    return cv2.erode(least, _AROUND, borderType=cv2.BORDER_REPLICATE)


def compiled_carry(view: CoarseView, cells: Cells, ages: Ages, camera: Camera, T_oc: Array, near: Depth, out: Ages) -> None:
    """`plain_carry` by Numba."""
    from idfslam.segmentation.kernels import numba_segmentation

    numba_segmentation.carry(cells, ages, view.depth, *intrinsics(view.camera, camera), T_oc, near, out)  # type: ignore[call-arg]


def plain_carry(view: CoarseView, cells: Cells, ages: Ages, camera: Camera, T_oc: Array, near: Depth, out: Ages) -> None:
    """Sets depths `near` and ages `out` (h, w) of the cells in which points are seen, in numpy. T_oc (4, 4): of the view in the camera."""
    inside, row, column, r = seen_at(view, camera, T_oc)
    shown = inside & cells
    at = row[shown], column[shown]
    np.minimum.at(near, at, r[shown].astype(np.float32))
    np.minimum.at(out, at, ages[shown])
