"""The nearest layer of a view, if the camera carries it along: a gripper, or a hand that holds something.

Nothing ever saw through its place, and it draws each pose to that of the frame before. It is found by standing still in the image, and
confirmed by the pose that is found without it.
"""

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.segmentation.coarse_view import CoarseView, in_pixels
from idfslam.segmentation.image_standstill import at_same_place, is_carried, stands_still
from idfslam.segmentation.nearest_layer import nearest_layer
from idfslam.slam.front_end.front_end import FrontEnd
from idfslam.slam.motion_segmentation.tracked_without import tracked_without
from idfslam.slam.tracked import Tracked
from idfslam.storage.state import State, Stateful

Cells = NDArray[np.bool_]

# [frames] from a view to the one that it is compared with, and between two that are compared. The first ones are compared with the first
# view. More: faster, slower motions tell, and a layer is found later. This and the rest: chosen by hand
_APART = 5
# [1] Share of the layer, below which a view does not show it any more: a hand has left. More: it is sooner taken to have left
_LEAVES = 0.5


class CarriedLayer(Stateful):
    """Compares every fifth view with the one five frames before, and the first ones with the first."""

    def __init__(self, frames: FramePoses) -> None:
        self._frames = frames
        self._earlier: tuple[int, CoarseView] | None = None  # number of a frame shortly before, and its view
        self._compared = 0  # views that were compared with others
        self._found: tuple[CoarseView, Cells] | None = None  # the view in which a layer was found, and its cells

    def state(self) -> State:
        """The earlier view, and the layer in the view in which it was found."""
        earlier = None if self._earlier is None else [self._earlier[0], self._earlier[1].state()]
        found = None if self._found is None else [self._found[0].state(), torch.from_numpy(self._found[1])]
        return {"earlier": earlier, "compared": self._compared, "found": found}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        earlier, found, self._compared = state["earlier"], state["found"], state["compared"]
        self._earlier = None if earlier is None else (earlier[0], CoarseView.from_state(earlier[1]))
        self._found = None if found is None else (CoarseView.from_state(found[0]), found[1].numpy())

    @property
    def is_known(self) -> bool:
        """Whether the camera carries a layer along."""
        return self._found is not None

    def cells(self, view: CoarseView) -> Cells:
        """(h, w) the cells of a view that show the layer."""
        return np.zeros(view.depth.shape, np.bool_) if self._found is None else at_same_place(view, *self._found)

    def follow(self, view: CoarseView) -> Cells:
        """`cells` of the next view. The layer is forgotten if it has left."""
        cells = self.cells(view)
        if self._found is None or cells.sum() >= _LEAVES * self._found[1].sum():
            return cells
        self._found = None
        return np.zeros_like(cells)

    def accept(self, index: int, coarse: Callable[[], CoarseView], *, lost: bool) -> None:
        """Takes a view of this number for the earlier one of those that follow, if it is time. lost: there is none with a pose."""
        if lost:
            self._earlier = None
        elif not self.is_known and (self._earlier is None or index - self._earlier[0] >= _APART):
            self._earlier = index, coarse()

    def run(self, view: Keyframe, tracked: Tracked, front_end: FrontEnd, coarse: Callable[[], CoarseView]) -> tuple[Tracked, Cells | None]:
        """The result for a view, tracked again without its nearest layer if that is carried along; and the layer's cells (h, w) then."""
        if self._earlier is None or self.is_known or tracked.is_lost:
            return tracked, None
        index, earlier = self._earlier
        if self._compared >= _APART and view.index - index < _APART:
            return tracked, None
        self._compared += 1
        shown = coarse()
        layer = nearest_layer(shown.depth)
        if layer is None or not stands_still(shown, earlier, layer):
            return tracked, None
        without, undo = tracked_without(in_pixels(layer, view.camera), view, front_end)
        draws = not without.is_lost and is_carried(shown, without.T_wc.numpy(), earlier, self._frames.T_wc(index).numpy(), layer)
        if draws and front_end.misfit(view, without.T_wc) < front_end.misfit(view, tracked.T_wc):
            self._found = shown, layer
            return without, layer
        undo()
        return tracked, None
