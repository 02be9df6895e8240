"""Segmentation of what moves in a stream of views: by the free space that earlier views saw, carried on from view to view.

The views that are remembered are segmented again when later ones have seen more: so a person who stood there from the beginning is found
in the first view once it has left its place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.segmentation.carrying import carried
from idfslam.segmentation.coarse_view import CoarseView
from idfslam.segmentation.free_space import PosedView, votes
from idfslam.segmentation.region_growing import grown
from idfslam.storage.state import State

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

# All of them were chosen by hand on generated rooms.
_EVERY = 6  # [frames] between views that are remembered besides keyframes. More: slow movements are found, and all of them later
_RECENT = 8  # such views. More: movement is found longer after it, slower
_WITNESSES = 3  # of the recent views, and as many of the others, are asked about a view. More: surer, slower
_AGAIN = 2  # [frames] from one keyframe that is segmented again to the next. More: faster, and keyframes heal later
_MOST = 200  # views of keyframes, beyond which every other one is dropped. More: more memory, 0.2 MB each
_APART, _TURNED = 2.5, np.cos(np.deg2rad(50))  # [m], cosine: views farther apart are not asked. More: witnesses that see little of a view
_SAME = 0.15  # [m] depth by which a carried cell may change. More: what a person uncovers is masked a little longer
_FOLLOWED = 0.3  # [m] the same for what has left its place in a view of some frames before. More: faster walkers are followed
_SETTLED = (
    10  # [frames] from when on a view that sees the same tells that it stays. More: slower walkers are found, false masks last longer
)
_BACK = 20  # of the newest keyframes are looked back at. More: older ones that serve as references again are masked at once
_NEWS = 16  # [cells] that must change for a keyframe's mask to be replaced. More: masks of keyframes follow later evidence less
_SUSPECTED = 20  # [frames] that such a cell stays masked longer after tracking has told that it moves. More: likewise
_AT_PLACE = 0.02  # [m] from what moves that a keyframe shows something at its place. More: more of its surroundings are masked there
_LASTS = 6  # [frames] that a cell stays masked without fresh evidence. More: masks flicker less, and false ones last longer


@dataclass(frozen=True)
class Remembered:
    """A view that is remembered, at its pose (4, 4) in its host keyframe."""

    host: int
    T_kc: Array
    view: CoarseView
    moving: Cells
    stored: bool  # whether it is the host keyframe itself
    left: Cells  # cells whose points later views saw through
    number: int  # of the frame

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


class Memory:
    """Remembered views, and what moved in the last one. `pose_of` gives the present camera-to-world pose (4, 4) of a keyframe."""

    def __init__(self, pose_of: Callable[[int], Array]) -> None:
        self._pose_of = pose_of
        self.keyframes: list[Remembered] = []
        self.recent: list[Remembered] = []
        self._last: Segmented | None = None  # the view before this one
        self._suspected: Cells | None = None  # cells of the next view that its tracking says to move
        self._turn = 0  # number of the keyframe that is segmented again next
        self._since = 0  # frames since one was remembered
        self._number = 0  # of frames so far

    def predicted(self, camera: Camera, T_wc: Array) -> Cells:
        """(h, w) the cells of a camera at a pose (4, 4) in which what moved last would be if it stood still."""
        return np.isfinite(self._carried(camera, T_wc)[0])

    def segment(self, view: CoarseView, T_wc: Array) -> Cells:
        """(h, w) the cells of a view at a pose (4, 4) that show what moves."""
        self._number += 1
        found = votes(view, T_wc, self._witnesses(T_wc, self._number, [self.recent, self.keyframes]))
        near, before = self._carried(view.camera, T_wc)
        goes_on = (np.abs(view.depth - near) < _SAME) & (~found.held | (before < 0))
        fresh = grown(found.moves, found.stays, view.depth) | (self._followed(view, T_wc) & ~found.stays)
        age = np.where(goes_on, before + 1, _LASTS + 1)
        age = np.where(fresh, np.minimum(age, 0), age)
        if self._suspected is not None:
            age[self._suspected] = -_SUSPECTED
        self._suspected = None
        self._last = Segmented(view, T_wc, age <= _LASTS, age.astype(np.int32))
        return self._last.moving

    def _carried(self, camera: Camera, T_wc: Array) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """(h, w) [m] the depth at which a camera would see what moved last; infinite elsewhere. And the ages of its cells."""
        if self._last is None:
            return np.full((camera.height, camera.width), np.float32(np.inf)), np.zeros((camera.height, camera.width), np.int32)
        return carried(self._last.view, self._last.T_wc, self._last.moving, camera, T_wc, ages=self._last.age)

    def _followed(self, view: CoarseView, T_wc: Array) -> Cells:
        """(h, w) the cells near the places that something has left since the recent views."""
        out = np.zeros(view.depth.shape, np.bool_)
        newest = len(self.recent) - 1
        look = newest if self._turn % 2 else self._turn // 2 % max(newest, 1)  # one a frame: the newest, then another in turns
        for k, kept in enumerate(self.recent):
            T = self._pose_of(kept.host) @ kept.T_kc
            if k == look:
                found = votes(kept.view, T, [PosedView(view, T_wc, out)])
                left = grown(found.moves, found.stays, kept.view.depth)
                self.recent[k] = kept = replace(kept, left=kept.left | left, moving=kept.moving | left)
            if kept.left.any():
                out |= np.abs(view.depth - carried(kept.view, T, kept.left, view.camera, T_wc)[0]) < _FOLLOWED
        return out

    @property
    def still(self) -> bool:
        """Whether nothing moves, as far as is known: not in the last view, and nothing has left its place in the recent ones."""
        suspected = self._suspected is not None
        return self._last is not None and not (suspected or self._last.moving.any() or any(kept.left.any() for kept in self.recent))

    def pass_over(self) -> None:
        """Counts a view that is not segmented."""
        self._number += 1
        self._since += 1

    def suspect(self, cells: Cells) -> None:
        """Takes cells (h, w) of the view that is segmented next for moving, and for a while what is carried on from them."""
        self._suspected = cells

    def forget_last(self) -> None:
        """What moved is not known any more: the camera was lost."""
        self._last = None

    def remember(self, host: int, T_kc: Array, *, stored: bool) -> None:
        """Keeps the view segmented last, if it is a stored keyframe or a while after the one before."""
        self._since += 1
        if self._last is None or not (stored or self._since >= _EVERY):
            return
        nothing = np.zeros_like(self._last.moving)
        kept = Remembered(host, T_kc, self._last.view, self._last.moving, stored, nothing, self._number)
        self._since = 0
        if stored:
            self.keyframes.append(kept)
            if len(self.keyframes) > _MOST:
                del self.keyframes[1::2]
        else:
            self.recent = [*self.recent, kept][-_RECENT:]

    def look_back_at_recent(self) -> None:
        """Takes what recent views show at the place of what moves now for the same body."""
        if self._last is not None and self._last.moving.any():
            for k, kept in enumerate(self.recent):
                near = self._carried(kept.view.camera, self._pose_of(kept.host) @ kept.T_kc)[0]
                self.recent[k] = replace(kept, moving=kept.moving | (np.abs(kept.view.depth - near) < _AT_PLACE))

    def look_back(self, host: int) -> Cells | None:
        """The moving cells of a remembered keyframe, if what moves now is at a place that it shows: then it shows the same body."""
        for k in range(len(self.keyframes) - 1, max(len(self.keyframes) - 1 - _BACK, -1), -1):
            kept = self.keyframes[k]
            if kept.host != host or self._last is None or not self._last.moving.any():
                continue
            near = self._carried(kept.view.camera, self._pose_of(host))[0]
            left = kept.left | (np.abs(kept.view.depth - near) < _AT_PLACE)
            if (left & ~kept.moving).sum() >= _NEWS:
                self.keyframes[k] = replace(kept, moving=kept.moving | left, left=left)
                return self.keyframes[k].moving
        return None

    def look_again(self) -> tuple[int, Cells] | None:
        """Segments one of the keyframes that see what the last view saw anew: its number, and its moving cells if they have changed."""
        self._turn += 1
        if self._last is None or self._turn % _AGAIN:
            return None
        near = [k for k, kept in enumerate(self.keyframes) if _unlikeness(self._pose_of(kept.host), self._last.T_wc) < np.inf]
        if not near:
            return None
        turn = near[self._turn // _AGAIN % len(near)]
        kept = self.keyframes[turn]
        T_wc = self._pose_of(kept.host)
        found = votes(kept.view, T_wc, self._witnesses(T_wc, kept.number, [self.recent]))
        left = kept.left | grown(found.moves, found.stays, kept.view.depth)
        moving = (kept.moving & ~found.stays) | left
        if (moving != kept.moving).sum() < _NEWS:
            return None
        self.keyframes[turn] = replace(kept, moving=moving, left=left)
        return kept.host, moving

    def state(self) -> State:
        """The remembered views, and what moved in the last one."""
        views = {name: [kept.state() for kept in getattr(self, name)] for name in ("keyframes", "recent")}
        last = None if self._last is None else self._last.state()
        return {**views, "last": last, "counts": [self._turn, self._since, self._number]}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.keyframes, self.recent = ([Remembered.from_state(kept) for kept in state[name]] for name in ("keyframes", "recent"))
        self._last = None if state["last"] is None else Segmented.from_state(state["last"])
        self._turn, self._since, self._number = state["counts"]

    def _witnesses(self, T_wc: Array, number: int, kinds: Sequence[Sequence[Remembered]]) -> list[PosedView]:
        """The views of each kind that see most of what a camera at a pose (4, 4) sees."""
        chosen: list[tuple[float, Remembered, Array]] = []
        for kind in kinds:
            near = []
            for kept in kind:
                T = self._pose_of(kept.host) @ kept.T_kc
                unlikeness = _unlikeness(T, T_wc)
                if unlikeness < np.inf:
                    near.append((unlikeness, kept, T))
            chosen += sorted(near, key=lambda item: item[0])[:_WITNESSES]
        return [PosedView(kept.view, T, kept.moving, abs(number - kept.number) >= _SETTLED) for _, kept, T in chosen]


def _unlikeness(T: Array, T_wc: Array) -> float:
    """How far two poses (4, 4) are apart, for the choice of views; infinite: they hardly see the same."""
    apart, facing = float(np.linalg.norm(T[:3, 3] - T_wc[:3, 3])), float(T[:3, 2] @ T_wc[:3, 2])
    return apart / _APART + 2 * (1 - facing) if apart < _APART and facing > _TURNED else np.inf


def _kept(array: NDArray[Any]) -> torch.Tensor:
    """An array as a state has it."""
    return torch.from_numpy(array.copy())


def _array(tensor: torch.Tensor) -> NDArray[Any]:
    """The array that `_kept` was given."""
    return tensor.numpy().copy()
