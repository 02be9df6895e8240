"""What stands still in the image while all else moves: a gripper, a hand that holds something, the hood of a vehicle.

The camera carries it along. A near thing of the scene moves more in the image than what lies farther, so that both can be told without a
pose. With a pose that was found without it, two hypotheses compete: an earlier image shows it at the same place, or where it would have
been seen if it were a part of the scene.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.segmentation.coarse_view import CoarseView
from idfslam.segmentation.constants import SLACK
from idfslam.segmentation.free_space import seen_at

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

# [1] Mean squared flow of a layer over the rest's, and squared difference to an image where it stands still over that where it is a part of
# the scene, below which it stands still. Grippers have flows of 0.014 to 0.078 from 5 frames before; of 117 pairs of freiburg1_rpy and
# redkitchen the least had 1.0. More: layers are tried that may be part of the scene, and taken for carried
_LESS = 0.25
# [cells^2] Least squared flow of the rest: a third of a cell. More: slower motions do not tell; less: noise passes for flow. Chosen by hand
_MOVES = 0.1
_AROUND = np.ones((3, 3), np.uint8)  # a cell and its neighbours


def stands_still(view: CoarseView, earlier: CoarseView, layer: Cells) -> bool:
    """Whether a layer (h, w) of a view moves much less in the image since an earlier view than the rest, by the flow along gradients.

    Of the rest the median counts, over the steeper half of its cells: one who walks before a camera that stands is not all of it.
    """
    change, slope = _difference(view, earlier.brightness * _gain(view, earlier)), sum(g**2 for g in np.gradient(view.brightness))
    rest = ~layer & (slope > 0)
    if not rest.any() or not slope[layer].any():
        return False
    steep = rest & (slope >= np.median(slope[rest]))
    moves = float(np.median(change[steep] / slope[steep]))
    return bool(moves > _MOVES and change[layer].sum() < _LESS * moves * slope[layer].sum())


def is_carried(view: CoarseView, T_wc: Array, earlier: CoarseView, T_earlier: Array, layer: Cells) -> bool:
    """Whether an earlier view shows a layer (h, w) of a view at the same cells, rather than where a part of the scene would have been.

    T_wc, T_earlier (4, 4): the poses, found without the layer.
    """
    inside, row, column, _ = seen_at(view, earlier.camera, np.linalg.inv(T_earlier) @ T_wc)
    shown, brightness = layer & inside, earlier.brightness * _gain(view, earlier)
    carried, static = (float(_difference(view, image)[shown].sum()) for image in (brightness, brightness[row, column]))
    return carried < _LESS * static


def at_same_place(view: CoarseView, found: CoarseView, layer: Cells) -> Cells:
    """(h, w) the cells of a view that show what a layer (h, w) of another view shows at these cells or beside them, by their depth."""
    near = cv2.erode(np.where(layer, found.near, np.float32(np.inf)), _AROUND)
    far = cv2.dilate(np.where(layer, found.depth, np.float32(0)), _AROUND)
    return np.asarray((view.depth > near - SLACK) & (view.depth < far + SLACK)) | (layer & (view.depth <= 0))


def without(view: CoarseView, cells: Cells) -> CoarseView:
    """The view without cells (h, w): they have no reading."""
    spread = cv2.dilate(cells.astype(np.uint8), _AROUND) > 0
    depth, far = np.where(cells, np.float32(0), view.depth), np.where(spread, np.float32(0), view.far)
    near = np.where(spread, np.float32(np.inf), view.near)
    return CoarseView(view.camera, depth, near, far, view.brightness, view.dark, view.bright)


def _gain(view: CoarseView, earlier: CoarseView) -> float:
    """[1] the ratio of the mean brightness of two views."""
    return float(view.brightness.mean() / max(float(earlier.brightness.mean()), 1e-6))


def _difference(view: CoarseView, brightness: NDArray[np.float32]) -> NDArray[np.float32]:
    """(h, w) squared differences of a view's brightness to another one."""
    return np.asarray((view.brightness - brightness) ** 2)
