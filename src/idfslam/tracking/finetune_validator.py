"""Validation of finetuning on pairs of keyframes that are never trained on. Steps that make the tracker worse there are rolled back."""

import copy
from collections import OrderedDict
from collections.abc import Callable, Sequence
from itertools import islice
from typing import Any

import torch
from torch import Tensor, nn

from idfslam.geometry import se3
from idfslam.storage.state import State, adam_dict, plain_adam
from idfslam.tracking.frame_features import FrameFeatures
from idfslam.tracking.overlap import overlapping_pixels

# Distance of the two keyframes of a validation pair in the graph's order. Finetuning trains on consecutive ones, so these are never trained
# on. More: harder pairs. Chosen by hand.
_APART = 2
# [1] Least share of a keyframe's measured pixels that the other one sees too. More: fewer and easier pairs. Chosen by hand.
_MIN_OVERLAP = 0.2


class FinetuneValidator:
    """Keeps the best weights and their optimiser's state, and rolls back to both when later weights are clearly worse.

    A rollback halves the learning rate: a rate that did harm once will do it again.
    """

    def __init__(self, learning: nn.Module, optimiser: torch.optim.Optimizer, margin: float) -> None:
        self._learning, self._optimiser, self._margin = learning, optimiser, margin
        self._best: tuple[dict[str, Tensor], dict[str, Any]] = self._state()
        self.rollbacks = 0  # number of rollbacks

    def state(self) -> State:
        """The best weights, their optimiser's state, and the number of rollbacks."""
        weights, optimiser = self._best
        return {"weights": dict(weights), "adam": plain_adam(optimiser), "rollbacks": self.rollbacks}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._best, self.rollbacks = (OrderedDict(state["weights"]), adam_dict(state["adam"])), state["rollbacks"]

    @torch.no_grad()
    def validate(self, score: Callable[[], float]) -> bool:
        """Compares the present weights with the best ones by `score` (higher is better); False if they were rolled back."""
        present, state = score(), self._state()
        self._restore(self._best)
        best = score()
        if present < (1 - self._margin) * best:
            self.rollbacks += 1
            for group in self._optimiser.param_groups:
                group["lr"] /= 2
            self._best = self._state()
            return False
        self._restore(state)
        if present >= best:
            self._best = state
        return True

    def _state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        return copy.deepcopy((self._learning.state_dict(), self._optimiser.state_dict()))

    def _restore(self, state: tuple[dict[str, Tensor], dict[str, Any]]) -> None:
        self._learning.load_state_dict(state[0])
        self._optimiser.load_state_dict(copy.deepcopy(state[1]))


def validation_pairs(keyframes: Sequence[FrameFeatures], T_wk: Tensor, count: int, generator: torch.Generator) -> list[tuple[int, int]]:
    """Up to `count` random pairs (i, i + 2) of overlapping keyframes with poses (N, 4, 4). At most 3 * count pairs are tested."""

    def overlap(i: int, j: int) -> bool:
        return _overlap(keyframes[i], keyframes[j], se3.inverse(T_wk[i]) @ T_wk[j]) >= _MIN_OVERLAP

    drawn = torch.randperm(max(0, len(keyframes) - _APART), generator=generator)[: 3 * count].tolist()
    pairs = ((i, i + _APART) for i in drawn if overlap(i, i + _APART))
    return list(islice(pairs, count))  # stops early: extracting a keyframe's features again takes as long as tracking a frame


def _overlap(keyframe: FrameFeatures, frame: FrameFeatures, T_kc: Tensor) -> float:
    """Share of the frame's measured pixels that the keyframe sees too."""
    return len(overlapping_pixels(T_kc, keyframe, frame).index) / max(1, int(frame.valid.sum()))
