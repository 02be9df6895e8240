"""What a viewer may read of a SLAM system while it runs."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.frame import Status, StoredKeyframe


class ClosedLoop(Protocol):
    """A closed loop between two stored keyframes."""

    @property
    def a(self) -> int: ...  # number of a stored keyframe

    @property
    def b(self) -> int: ...


class SlamView(Protocol):
    """The part of `Slam` that a viewer reads. N frames have been processed so far."""

    @property
    def timings(self) -> Mapping[str, Sequence[float]]: ...  # [ms] of each call so far, by stage

    def stored_keyframes(self) -> Sequence[StoredKeyframe]:
        """All keyframes at their present poses."""

    def loops(self) -> Sequence[ClosedLoop]:
        """The loops that were closed and still are."""

    def trajectory(self) -> NDArray[np.float64]:
        """(N, 4, 4) camera-to-world poses of all frames."""

    def statuses(self) -> Sequence[Status]:
        """How each frame's pose was found."""

    def mesh(self, resolution: float) -> trimesh.Trimesh:
        """The observed surface in cells of `resolution` [m], with vertex colours."""
