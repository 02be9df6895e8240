"""Validation of finetuning: steps that make the tracker worse on pairs of keyframes that it never trains on are rolled back."""

import copy
from collections import OrderedDict
from collections.abc import Callable, Sequence
from itertools import islice
from typing import Any

import torch
from torch import Tensor, nn

from idfslam.geometry import se3
from idfslam.storage.state import State, adam_dict, plain_adam
from idfslam.tracking.frame_features import Described
from idfslam.tracking.overlap import partners

_APART = 2  # keyframes between the two of a validation pair; finetuning trains on consecutive ones, so these are never trained on
_MIN_OVERLAP = 0.2  # [1] least share of a keyframe's measured pixels that the other sees too; more: fewer and easier pairs


class Guard:
    """Remembers the weights that did best, and their optimiser; goes back to both when later ones do clearly worse.

    After going back, the rate is half of what it was: a rate that does harm once will do it again.
    """

    def __init__(self, learning: nn.Module, optimiser: torch.optim.Optimizer, margin: float) -> None:
        self._learning, self._optimiser, self._margin = learning, optimiser, margin
        self._best: tuple[dict[str, Tensor], dict[str, Any]] = self._state()
        self.undone = 0  # how often it went back

    def state(self) -> State:
        """The best weights, their optimiser, and how often it went back."""
        weights, optimiser = self._best
        return {"weights": dict(weights), "adam": plain_adam(optimiser), "undone": self.undone}

    def restore(self, state: State) -> None:
        """What `state` told."""
        self._best, self.undone = (OrderedDict(state["weights"]), adam_dict(state["adam"])), state["undone"]

    @torch.no_grad()
    def examine(self, score: Callable[[], float]) -> bool:
        """Whether the weights may stay: `score` (higher is better) of them and of the best, on the same pairs, decides."""
        now, state = score(), self._state()
        self._restore(self._best)
        best = score()
        if now < (1 - self._margin) * best:
            self.undone += 1
            for group in self._optimiser.param_groups:
                group["lr"] /= 2
            self._best = self._state()
            return False
        self._restore(state)
        if now >= best:
            self._best = state
        return True

    def _state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        return copy.deepcopy((self._learning.state_dict(), self._optimiser.state_dict()))

    def _restore(self, state: tuple[dict[str, Tensor], dict[str, Any]]) -> None:
        self._learning.load_state_dict(state[0])
        self._optimiser.load_state_dict(copy.deepcopy(state[1]))


def held_out(keyframes: Sequence[Described], T_wk: Tensor, count: int, generator: torch.Generator) -> list[tuple[int, int]]:
    """Up to `count` pairs (i, i + 2) of keyframes with poses (N, 4, 4) that see the same, at random; of at most 3 * count drawn."""

    def see_the_same(i: int, j: int) -> bool:
        return _overlap(keyframes[i], keyframes[j], se3.inverse(T_wk[i]) @ T_wk[j]) >= _MIN_OVERLAP

    drawn = torch.randperm(max(0, len(keyframes) - _APART), generator=generator)[: 3 * count].tolist()
    pairs = ((i, i + _APART) for i in drawn if see_the_same(i, i + _APART))
    return list(islice(pairs, count))  # and no more are looked at: to describe a keyframe anew takes as long as to track a frame


def _overlap(keyframe: Described, frame: Described, T_kc: Tensor) -> float:
    """Share of the frame's measured pixels that the keyframe sees too."""
    return len(partners(T_kc, keyframe, frame).index) / max(1, int(frame.valid.sum()))
