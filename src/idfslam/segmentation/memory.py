"""The memory of views: what later views of the stream are compared with, and what is found out later about them.

It has keyframes, and besides them a view of every few frames, for a while. They are segmented again when later views have seen more: so a
person who stood there from the beginning is found in the first view once it has left its place.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from idfslam.segmentation.carrying import carried
from idfslam.segmentation.coarse_view import CoarseView
from idfslam.segmentation.free_space import PosedView, votes
from idfslam.segmentation.region_growing import grown
from idfslam.segmentation.remembered import Remembered, Segmented
from idfslam.segmentation.witnesses import Witnesses
from idfslam.storage.state import State, Stateful

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

# All of them were chosen by hand on generated rooms.
_EVERY = 6  # [frames] between views that are remembered besides keyframes. More: slow movements are found, and all of them later
_RECENT = 8  # such views. More: movement is found longer after it, slower
_AGAIN = 2  # [frames] from one keyframe that is segmented again to the next. More: faster, and keyframes heal later
_MOST = 200  # views of keyframes, beyond which every other one is dropped. More: more memory, 0.2 MB each
_FOLLOWED = 0.3  # [m] depth by which what left its place some frames before may change. More: faster walkers are followed
_BACK = 20  # newest keyframes that are searched for a body that moves now. More: older ones that are references again are masked at once
_NEWS = 16  # [cells] that must change for a keyframe's mask to be replaced. More: masks of keyframes follow later evidence less
_AT_PLACE = 0.02  # [m] from what moves that a keyframe shows something at its place. More: more of its surroundings are masked there
_TURNS = 2  # frames in which each recent view is compared once with what moves. More: faster, and all of it later


class Memory(Stateful):
    """Remembered views. `pose_of` gives the present camera-to-world pose (4, 4) of a keyframe."""

    def __init__(self, pose_of: Callable[[int], Array]) -> None:
        self.keyframes: list[Remembered] = []
        self.recent: list[Remembered] = []
        self.frames = 0  # frames so far: the number of the newest
        self._witnesses = Witnesses(pose_of)
        self._turn = 0  # number of the keyframe that is segmented again next
        self._since = 0  # frames since a view was remembered

    def witnesses(self, T_wc: Array, number: int, *, moves: bool) -> dict[int, PosedView]:
        """The views that are asked about the frame `number` at a pose (4, 4), by their own numbers. moves: whether anything moves."""
        return self._witnesses.asked(T_wc, number, [self.recent, self.keyframes], moves=moves)

    def prove(self, through: dict[int, Cells], moving: Cells) -> None:
        """Takes note of the views that saw through the cells that move (h, w). through: the cells of each view, by its number."""
        self._witnesses.prove(through, moving)

    def pass_over(self) -> None:
        """Counts a frame that is not segmented."""
        self.frames += 1
        self._since += 1

    def add(self, segmented: Segmented | None, host: int, T_kc: Array, *, stored: bool) -> None:
        """Keeps a view at its pose (4, 4) in its host, if it is stored or a while after the one before. None: it was not segmented."""
        self._since += 1
        if segmented is None or not (stored or self._since >= _EVERY):
            return
        kept = Remembered(host, T_kc, segmented.view, segmented.moving, stored, np.zeros_like(segmented.moving), self.frames)
        self._since = 0
        if stored:
            self.keyframes.append(kept)
            if len(self.keyframes) > _MOST:
                del self.keyframes[1::2]
        else:
            self.recent = [*self.recent, kept][-_RECENT:]

    # What has left its place since a view was taken: later views see through it

    @property
    def knows_what_left(self) -> bool:
        """Whether something has left its place since one of the recent views."""
        return any(kept.left.any() for kept in self.recent)

    def learn_what_left(self, view: CoarseView, T_wc: Array) -> None:
        """One recent view a frame learns what a view at a pose (4, 4) saw through: the newest, then another one in turns."""
        if not self.recent:
            return
        newest = len(self.recent) - 1
        look = newest if self._turn % 2 else self._turn // 2 % max(newest, 1)
        kept = self.recent[look]
        found = votes(kept.view, self._witnesses.pose(kept), [PosedView(view, T_wc, np.zeros(view.depth.shape, np.bool_))])
        left = grown(found.moves, found.stays, kept.view.depth)
        self.recent[look] = replace(kept, left=kept.left | left, moving=kept.moving | left)

    def near_what_left(self, view: CoarseView, T_wc: Array, number: int) -> Cells:
        """(h, w) the cells of a view at a pose (4, 4) near the places that something has left, since every other recent view in turns."""
        near = np.zeros(view.depth.shape, np.bool_)
        for kept in self.recent[number % _TURNS :: _TURNS]:
            if kept.left.any():
                place = carried(kept.view, self._witnesses.pose(kept), kept.left, view.camera, T_wc)
                near |= np.abs(view.depth - place) < _FOLLOWED
        return near

    # What moves now, in earlier views: at the same place they show the same body

    def mask_in_recent(self, now: Segmented | None) -> None:
        """Masks in recent views, in turns, what they show at the place of what moves now."""
        if now is not None and now.moving.any():
            for k in range(self.frames % _TURNS, len(self.recent), _TURNS):
                kept = self.recent[k]
                self.recent[k] = replace(kept, moving=kept.moving | self._at_place(kept, now))

    def mask_in_keyframe(self, host: int, now: Segmented | None) -> Cells | None:
        """Masks in a keyframe what it shows at the place of what moves now. Returns its moving cells (h, w); None: hardly any are new."""
        if now is None or not now.moving.any():
            return None
        for k in range(len(self.keyframes) - 1, max(len(self.keyframes) - 1 - _BACK, -1), -1):
            kept = self.keyframes[k]
            if kept.host != host:
                continue
            left = kept.left | self._at_place(kept, now)
            if (left & ~kept.moving).sum() >= _NEWS:
                self.keyframes[k] = replace(kept, moving=kept.moving | left, left=left)
                return self.keyframes[k].moving
        return None

    def _at_place(self, kept: Remembered, now: Segmented) -> Cells:
        """(h, w) the cells of a remembered view that show something at the place of what moves now."""
        near = carried(now.view, now.T_wc, now.moving, kept.view.camera, self._witnesses.pose(kept))
        return np.asarray(np.abs(kept.view.depth - near) < _AT_PLACE)

    def segment_again(self, now: Segmented | None) -> tuple[int, Cells] | None:
        """Segments one of the keyframes that see what the present view sees anew, by the recent views, every few frames.

        Returns its number, and its moving cells (h, w); None: hardly any have changed.
        """
        self._turn += 1
        if now is None or self._turn % _AGAIN:
            return None
        near = np.flatnonzero(self._witnesses.see(self.keyframes, now.T_wc))
        if not len(near):
            return None
        turn = near[self._turn // _AGAIN % len(near)]
        kept = self.keyframes[turn]
        T_wc = self._witnesses.pose(kept)
        found = votes(kept.view, T_wc, list(self._witnesses.nearest(T_wc, kept.number, [self.recent]).values()))
        left = kept.left | grown(found.moves, found.stays, kept.view.depth)
        moving = (kept.moving & ~found.held) | left
        if (moving != kept.moving).sum() < _NEWS:
            return None
        self.keyframes[turn] = replace(kept, moving=moving, left=left)
        return kept.host, moving

    def state(self) -> State:
        """The views, those that proved what moves, and the counts of frames."""
        views = {name: [kept.state() for kept in getattr(self, name)] for name in ("keyframes", "recent")}
        return {**views, "counts": [self.frames, self._turn, self._since], "proven": list(self._witnesses.proven)}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.keyframes, self.recent = ([Remembered.from_state(kept) for kept in state[name]] for name in ("keyframes", "recent"))
        self.frames, self._turn, self._since = state["counts"]
        self._witnesses.proven = list(state["proven"])
