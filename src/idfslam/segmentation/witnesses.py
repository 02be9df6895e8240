"""Which remembered views are asked about a view: the most similar ones, those that proved what moves to move, and others in turns."""

from collections.abc import Callable, Sequence

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
# [frames] from when on a view that sees the same tells that it stays. More: slower walkers are found, false masks last longer
_TESTIFIES = 10
STANDS = 90  # [frames] after which what stands in its place is part of the scene. More: what was moved is mapped later, or left out


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
        """`nearest`, those that proved what moves, the newest that shows what stands for long; and, if anything moves, another in turns."""
        in_range = [self._in_range(T_wc, kind) for kind in kinds]
        known = {kept.number: kept for kind in in_range for kept in kind}
        chosen = [kept.number for kind in in_range for kept in kind[:_NEAREST]]
        more = {n for n in self.proven if n in known}
        more |= set(sorted(n for n in known if number - n >= STANDS)[-1:])
        rest = sorted(known.keys() - more - set(chosen))
        more |= {rest[number % len(rest)]} if rest and moves else set()
        return {n: self._posed(known[n], number) for n in (*chosen, *sorted(more - set(chosen)))}

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

    def see(self, kind: Sequence[Remembered], T_wc: Array) -> Cells:
        """(N,) whether remembered views see some of what a camera at a pose (4, 4) sees."""
        return np.isfinite(self._unlikeness(kind, T_wc))

    def _in_range(self, T_wc: Array, kind: Sequence[Remembered]) -> list[Remembered]:
        """The views that see some of what a camera at a pose (4, 4) sees, the most similar first."""
        unlike = self._unlikeness(kind, T_wc)
        return [kind[k] for k in np.argsort(unlike, kind="stable") if unlike[k] < np.inf]

    def _unlikeness(self, kind: Sequence[Remembered], T_wc: Array) -> Array:
        """(N,) how far views are from a pose (4, 4); infinite: they hardly see the same."""
        hosts, in_hosts = [self._pose_of(kept.host) for kept in kind], [kept.T_kc for kept in kind]
        T = np.array(hosts).reshape(-1, 4, 4) @ np.array(in_hosts).reshape(-1, 4, 4)
        apart, facing = np.linalg.norm(T[:, :3, 3] - T_wc[:3, 3], axis=1), T[:, :3, 2] @ T_wc[:3, 2]
        return np.where((apart < _APART) & (facing > _TURNED), apart / _APART + 2 * (1 - facing), np.inf)

    def pose(self, kept: Remembered) -> Array:
        """The present camera-to-world pose (4, 4) of a remembered view."""
        return np.asarray(self._pose_of(kept.host) @ kept.T_kc)

    def _posed(self, kept: Remembered, number: int) -> PosedView:
        age = abs(number - kept.number)
        return PosedView(kept.view, self.pose(kept), kept.around, testifies=age >= _TESTIFIES, settles=age >= STANDS)
