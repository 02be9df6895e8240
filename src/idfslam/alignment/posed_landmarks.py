"""The landmarks of the keyframes that a frame is aligned to, with the keyframes' poses."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from idfslam.alignment.landmarks import Landmarks

Posed = tuple[Landmarks, Tensor]
"""Landmarks of a keyframe, and its pose (4, 4) float64."""


@dataclass(frozen=True)
class PosedLandmarks:
    """The landmarks of references, and of a recent frame, which is no evidence for a pose.

    Compiled loops take the landmarks of all keyframes one after another. They are laid out so once, and used at each step.
    """

    references: Sequence[Posed]
    recent: Posed | None = None
    _luminance: dict[int, NDArray[np.float32]] = field(default_factory=dict, init=False)

    @cached_property
    def all(self) -> Sequence[Posed]:
        """Those of the references, then those of the recent frame."""
        return [*self.references, *([] if self.recent is None else [self.recent])]

    @property
    def evidence(self) -> int:
        """The number of references."""
        return len(self.references)

    @cached_property
    def count(self) -> int:
        """The number of the references' landmarks."""
        return sum(len(marks.points) for marks, _ in self.references)

    @cached_property
    def points(self) -> NDArray[np.float32]:
        """(M, 3) [m] the landmarks of all keyframes, each along the axes of its own."""
        return np.concatenate([marks.points.numpy() for marks, _ in self.all])

    @cached_property
    def starts(self) -> NDArray[np.int64]:
        """(K + 1,) where those of each of K keyframes begin, and where the last ones end."""
        return np.cumsum([0, *(len(marks.points) for marks, _ in self.all)])

    @cached_property
    def poses(self) -> NDArray[np.float64]:
        """(K, 4, 4) of the keyframes."""
        return np.stack([T_wk.numpy() for _, T_wk in self.all])

    def luminance(self, level: int) -> NDArray[np.float32]:
        """(M,) their brightness on a level of the pyramid."""
        if level not in self._luminance:
            self._luminance[level] = np.concatenate([marks.luminance[level].numpy() for marks, _ in self.all])
        return self._luminance[level]
