"""The front end: it computes a frame's pose from the keyframes and the map. Each front end is one class; `compose.py` names them."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from idfslam.graph.keyframe import Keyframe
from idfslam.sensing.rectification import RowTimes
from idfslam.slam.tracked import Tracked
from idfslam.storage.state import Stateful


class FrontEnd(Stateful, ABC):
    """Tracks frames. Another front end must implement `track` only."""

    @abstractmethod
    def track(self, view: Keyframe) -> Tracked:
        """Tracks a view, whose pose is the predicted one. The graph has at least one keyframe."""

    def accept(self, view: Keyframe, tracked: Tracked) -> None:
        """Learns from the final result for a view, after recovery. The view still has its predicted pose."""

    def misfit(self, view: Keyframe, T_wc: Tensor) -> float:
        """[1] The photometric error of a view at a pose (4, 4), of what is not hidden in it; 0: unknown."""
        return 0.0

    def row_times(self, keyframe: Keyframe) -> RowTimes:
        """The times of the rows of a keyframe's images as they were taken, as far as they are known by now."""
        return RowTimes()

    def likeliest_row_times(self, keyframe: Keyframe) -> tuple[RowTimes, NDArray[np.float64]]:
        """The same with estimates that are not sure enough to track by, and standard deviations (3,) [s] of `RowTimes.array`."""
        return self.row_times(keyframe), np.zeros(3)

    def smooth(self) -> None:
        """Smooths the poses of the frames after the last one, by what is known of the motion between them."""

    def undo(self) -> Callable[[], None]:
        """What makes it forget that a view was tracked again after this call. The view itself is not its concern."""
        return lambda: None

    def figures(self) -> dict[str, Any]:
        """What metrics.json reports of it."""
        return {}
