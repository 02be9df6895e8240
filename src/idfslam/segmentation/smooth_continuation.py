"""Surfaces continued: cells that go on smoothly from what is known to stay belong to it.

What a body uncovers was never seen before, and lies near where the body was. It is told from the body by its surface: floors and walls go
on where they were hidden, and a body that stands on them begins with a bend. So regions grow as far as they are smooth (Rabbani et al.,
ISPRS Commission V Symposium 2006). Inverse depth is linear over the cells of a plane, whatever its slant.
"""

import numpy as np
from numpy.typing import NDArray

from idfslam.segmentation.plain_form import form

Cells = NDArray[np.bool_]

# All of them were chosen by hand on generated rooms.
_SPAN = 3  # [cells] between the three cells that a bend is measured over. More: less noise, and less is continued near edges
_BEND = 0.008  # [1/m] second difference of inverse depth over them that is still smooth. More: feet pass for floor; less: floor for feet
_STEP = 0.03  # [1/m] largest difference of inverse depth to the neighbour. More: surfaces are continued over edges
# [1] of the cells of a connected region that must be known to stay for the others to belong to them. More: less is continued. Less: a body
# of which an earlier view missed a part is taken for scene
_MAJORITY = 0.5
# [cells], [1/m]: likewise, of a valley between surfaces. More: less noise, and thinner things have none; fewer valleys, so that bodies are
# continued over floors
_VALLEY_SPAN, _VALLEY = 2, 0.015
_PASSES = 3  # over the image, there and back. More: surfaces are continued round more corners, slower


def continued(stays: Cells, may: Cells, depth: NDArray[np.float32]) -> Cells:
    """(h, w) the cells that stay, and of those that may stay the ones that go on smoothly from a majority of them, by depth (h, w) [m]."""
    from idfslam.segmentation.kernels import numba_segmentation

    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    out = stays.copy()
    form(numba_segmentation.continue_smoothly)(out, may & (depth > 0), inverse, _SPAN, np.float32(_BEND), np.float32(_STEP), _PASSES)
    form(numba_segmentation.drop_regions)(out, stays, stays, inverse, np.float32(_STEP), False, 0, _MAJORITY)
    return out


def valleys(depth: NDArray[np.float32]) -> Cells:
    """(h, w) the cells in which the surface bends away from the camera, by depth (h, w) [m]: such as between a body and its floor.

    Bodies are mostly convex, so that these are where one ends (Stein et al., CVPR 2014).
    """
    inverse = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    out = np.zeros(depth.shape, np.bool_)
    for image, bends in ((inverse, out), (inverse.T, out.T)):
        before, middle, after = image[: -2 * _VALLEY_SPAN], image[_VALLEY_SPAN:-_VALLEY_SPAN], image[2 * _VALLEY_SPAN :]
        measured = (before > 0) & (middle > 0) & (after > 0)
        bends[_VALLEY_SPAN:-_VALLEY_SPAN] |= measured & (before - 2 * middle + after > _VALLEY)
    return out
