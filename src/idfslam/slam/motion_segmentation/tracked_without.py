"""A view that was tracked is tracked once more without a part of it, from which its pose may have come."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from idfslam.graph.keyframe import Keyframe
from idfslam.sensing.rectification import Rectification
from idfslam.slam.front_end.front_end import FrontEnd
from idfslam.slam.tracked import Tracked


def tracked_without(pixels: NDArray[np.bool_], view: Keyframe, front_end: FrontEnd) -> tuple[Tracked, Callable[[], None]]:
    """The result for a view without these pixels (H, W) too, which are hidden in it now; and what takes back that it was tracked again."""
    before, undo, hidden = _Before.of(view), front_end.undo(), view.moving
    view.hide(pixels if hidden is None else pixels | hidden)
    tracked = front_end.track(view)

    def take_back() -> None:
        before.restore(view)
        undo()

    return tracked, take_back


@dataclass(frozen=True)
class _Before:
    """What tracking sets in a view."""

    hidden: NDArray[np.bool_] | None
    T_predicted: Tensor
    rectification: Rectification | None
    registered: bool

    @classmethod
    def of(cls, view: Keyframe) -> "_Before":
        return cls(view.moving, view.T_wk.clone(), view.rectification, view.registered)

    def restore(self, view: Keyframe) -> None:
        view.hide(self.hidden)
        view.T_wk, view.registered = self.T_predicted, self.registered
        if self.rectification is not None and view.rectification is not self.rectification:
            view.rectify(self.rectification)
