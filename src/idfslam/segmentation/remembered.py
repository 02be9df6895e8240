"""Views that are remembered for comparisons with later ones, and the one before the present."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.segmentation.coarse_view import CoarseView
from idfslam.storage.state import State

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

_AROUND = np.ones((3, 3), np.uint8)  # cells around what moves that tell nothing either. Larger: fewer false masks end beside a body


@dataclass(frozen=True)
class Remembered:
    """A view that is remembered, at its pose (4, 4) in its host keyframe."""

    host: int
    T_kc: Array
    view: CoarseView
    moving: Cells
    stored: bool  # whether it is the host keyframe itself
    left: Cells  # cells whose points later views saw through
    number: int  # of the frame: no two views have the same

    @cached_property
    def around(self) -> Cells:
        """(h, w) the cells that move, and those beside them: silhouettes are of the body and of what is behind it."""
        return cv2.dilate(self.moving.astype(np.uint8), _AROUND).astype(np.bool_)

    def state(self) -> State:
        """All of it."""
        arrays = {name: _kept(getattr(self, name)) for name in ("T_kc", "moving", "left")}
        return {"host": self.host, "view": self.view.state(), "stored": self.stored, "number": self.number, **arrays}

    @classmethod
    def from_state(cls, state: State) -> "Remembered":
        """What `state` was made from."""
        arrays = {name: _array(state[name]) for name in ("T_kc", "moving", "left")}
        return cls(host=state["host"], view=CoarseView.from_state(state["view"]), stored=state["stored"], number=state["number"], **arrays)


@dataclass(frozen=True)
class Segmented:
    """A view at its pose (4, 4), and what moves in it."""

    view: CoarseView
    T_wc: Array
    moving: Cells
    age: NDArray[np.int32]  # [frames] since there was evidence that a cell moves; negative: it is taken to move for so long

    def state(self) -> State:
        """All of it."""
        return {"view": self.view.state()} | {name: _kept(getattr(self, name)) for name in ("T_wc", "moving", "age")}

    @classmethod
    def from_state(cls, state: State) -> "Segmented":
        """What `state` was made from."""
        return cls(CoarseView.from_state(state["view"]), *(_array(state[name]) for name in ("T_wc", "moving", "age")))


def _kept(array: NDArray[Any]) -> torch.Tensor:
    """An array as a state has it."""
    return torch.from_numpy(array.copy())


def _array(tensor: torch.Tensor) -> NDArray[Any]:
    """The array that `_kept` was given."""
    return tensor.numpy().copy()
