"""Which remembered views are asked about a view: the most similar ones, those that proved what moves to move, and others in turns."""

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.segmentation.free_space import PosedView
from idfslam.segmentation.remembered import Remembered

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

# All of them were chosen by hand on generated rooms.
_NEAREST = 2  # of the recent views, and as many of the keyframes, are asked about a view. More: surer, slower
_PROVEN = 3  # views that saw through most of what moved last are asked again. More: more of one who stands still stays masked, slower
_LEAST = 24  # [cells] that such a view must have seen through, beside the others. More: fewer are asked, faster
_APART, _TURNED = 2.5, np.cos(np.deg2rad(50))  # [m], cosine: views farther apart are not asked. More: witnesses that see little of a view
_TESTIFIES = (
    10  # [frames] from when on a view that sees the same tells that it stays. More: slower walkers are found, false masks last longer
)
_STANDS = 90  # [frames] after which what stands in its place has become part of the scene. More: what was moved is mapped later

_AROUND = np.ones((3, 3), np.uint8)  # cells around what moves that tell nothing either. Larger: fewer false masks end beside a body


class Witnesses:
    """Chooses among remembered views. `pose_of` gives the present camera-to-world pose (4, 4) of a keyframe."""

    def __init__(self, pose_of: Callable[[int], Array]) -> None:
        self._pose_of = pose_of
        self.proven: list[int] = []  # numbers of the views that saw through what moved last

    def nearest(self, T_wc: Array, number: int, kinds: Sequence[Sequence[Remembered]]) -> dict[int, PosedView]:
        """The views of each kind that see most of what a camera at a pose (4, 4) sees in the frame `number`, by their own numbers."""
        chosen = [kept for kind in kinds for kept in self._in_range(T_wc, kind)[:_NEAREST]]
        return {kept.number: self._posed(kept, number) for kept in chosen}

    def asked(self, T_wc: Array, number: int, kinds: Sequence[Sequence[Remembered]], *, moves: bool) -> dict[int, PosedView]:
        """`nearest`, those that proved that something moves, the newest that shows what stands for long; and another in turns if any moves."""
        chosen = self.nearest(T_wc, number, kinds)
        known = {kept.number: kept for kind in kinds for kept in self._in_range(T_wc, kind)}
        more = {n for n in self.proven if n in known}
        more |= set(sorted(n for n in known if number - n >= _STANDS)[-1:])
        rest = sorted(known.keys() - chosen.keys() - more)
        more |= {rest[number % len(rest)]} if rest and moves else set()
        return chosen | {n: self._posed(known[n], number) for n in sorted(more - chosen.keys())}

    def prove(self, through: dict[int, Cells], moving: Cells) -> None:
        """Takes note of the views that together saw through most of the cells that move (h, w). through: the cells of each view."""
        left, rest, self.proven = moving, dict(through), []
        while rest and len(self.proven) < _PROVEN:
            number = max(rest, key=lambda n: int((rest[n] & left).sum()))
            cells = rest.pop(number)
            if (cells & left).sum() < _LEAST:
                return
            left = left & ~cells
            self.proven.append(number)

    def sees(self, kept: Remembered, T_wc: Array) -> bool:
        """Whether a remembered view sees some of what a camera at a pose (4, 4) sees."""
        return _unlikeness(self._pose(kept), T_wc) < np.inf

    def _in_range(self, T_wc: Array, kind: Sequence[Remembered]) -> list[Remembered]:
        """The views that see some of what a camera at a pose (4, 4) sees, the most similar first."""
        unlike = [_unlikeness(self._pose(kept), T_wc) for kept in kind]
        return [kind[k] for k in np.argsort(unlike, kind="stable") if unlike[k] < np.inf]

    def _pose(self, kept: Remembered) -> Array:
        return np.asarray(self._pose_of(kept.host) @ kept.T_kc)

    def _posed(self, kept: Remembered, number: int) -> PosedView:
        age = abs(number - kept.number)
        around = cv2.dilate(kept.moving.astype(np.uint8), _AROUND).astype(np.bool_)  # silhouettes are of the body and of what is behind it
        return PosedView(kept.view, self._pose(kept), around, testifies=age >= _TESTIFIES, settles=age >= _STANDS)


def _unlikeness(T: Array, T_wc: Array) -> float:
    """How far two poses (4, 4) are apart, for the choice of views; infinite: they hardly see the same."""
    apart, facing = float(np.linalg.norm(T[:3, 3] - T_wc[:3, 3])), float(T[:3, 2] @ T_wc[:3, 2])
    return apart / _APART + 2 * (1 - facing) if apart < _APART and facing > _TURNED else np.inf
