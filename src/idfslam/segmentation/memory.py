"""Segmentation of what moves in a stream of views: by the free space that earlier views saw, carried on from view to view.

The views that are remembered are segmented again when later ones have seen more: so a person who stood there from the beginning is found
in the first view once it has left its place.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.segmentation.blind_zone import blind
from idfslam.segmentation.carrying import carried, carried_with_ages
from idfslam.segmentation.coarse_view import CoarseView
from idfslam.segmentation.constants import NEVER, SLACK
from idfslam.segmentation.free_space import PosedView, Votes, votes
from idfslam.segmentation.region_growing import grown
from idfslam.segmentation.remembered import Remembered, Segmented
from idfslam.segmentation.smooth_continuation import continued
from idfslam.segmentation.witnesses import Witnesses
from idfslam.storage.state import State

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]
Ages = NDArray[np.int32]

# All of them were chosen by hand on generated rooms.
_EVERY = 6  # [frames] between views that are remembered besides keyframes. More: slow movements are found, and all of them later
_RECENT = 8  # such views. More: movement is found longer after it, slower
_AGAIN = 2  # [frames] from one keyframe that is segmented again to the next. More: faster, and keyframes heal later
_MOST = 200  # views of keyframes, beyond which every other one is dropped. More: more memory, 0.2 MB each
_SAME = 0.15  # [m] depth by which a carried cell may change. More: what a person uncovers is masked a little longer
_FOLLOWED = 0.3  # [m] the same for what has left its place in a view of some frames before. More: faster walkers are followed
_BACK = 20  # of the newest keyframes are looked back at. More: older ones that serve as references again are masked at once
_NEWS = 16  # [cells] that must change for a keyframe's mask to be replaced. More: masks of keyframes follow later evidence less
_SUSPECTED = 20  # [frames] that such a cell stays masked longer after tracking has told that it moves. More: likewise
_AT_PLACE = 0.02  # [m] from what moves that a keyframe shows something at its place. More: more of its surroundings are masked there
# Share of a cell, and of the slack, by which a predicted pose may be off. More: more views need no second segmentation, with rougher masks
_OFF = 0.3
_TURNS = 2  # frames in which each recent view is compared once with what moves. More: faster, and all of it later
# [frames] that a cell stays masked while nothing tells that it stays. More: who stands where no view saw through stays masked for longer,
# and false masks do. 60 gave no more
_LASTS = 30
# [cells] that a region of the newest view grows from what was seen through and what follows what has left: a part that is missed draws the
# pose. With 8 cells 2.1 % of the images of rooms 0, 4 and 6 were missed and 1.1 % masked wrongly, with 16 cells 1.4 and 1.3 %. More: the
# same
_WHOLE = 16


class Memory:
    """Remembered views, and what moved in the last one. `pose_of` gives the present camera-to-world pose (4, 4) of a keyframe."""

    def __init__(self, pose_of: Callable[[int], Array]) -> None:
        self._pose_of, self._witnesses = pose_of, Witnesses(pose_of)
        self.keyframes: list[Remembered] = []
        self.recent: list[Remembered] = []
        self._last: Segmented | None = None  # the view before this one
        self._suspected: Cells | None = None  # cells of the next view that its tracking says to move
        self._expected: tuple[Segmented, dict[int, Cells]] | None = None  # the next view, as it is at its predicted pose
        self._turn = 0  # number of the keyframe that is segmented again next
        self._since = 0  # frames since one was remembered
        self._number = 0  # of frames so far

    def expect(self, view: CoarseView, T_predicted: Array) -> Cells:
        """(h, w) the cells of a view that show what moves if it is at a predicted pose (4, 4). Nothing is known before the first view."""
        if self._last is None or self.still:
            self._expected = None
            return np.zeros(view.depth.shape, np.bool_)
        self._expected = self._judged(view, T_predicted, self._number + 1, self._all_near_left(view, T_predicted, self._number))
        return self._expected[0].moving

    def reconsider(self, view: CoarseView, T_tracked: Array) -> Cells:
        """(h, w) what `segment` would give for a view at a pose (4, 4), which may be found wrong yet: recent views learn nothing."""
        recent = list(self.recent)
        self._expected = self._judged(view, T_tracked, self._number + 1, self._followed(view, T_tracked, self._number + 1))
        self.recent = recent
        return self._expected[0].moving

    def expects(self, T_wc: Array) -> bool:
        """Whether `confirm` tells what moves in the view that was expected, were its pose (4, 4) this one."""
        return self._expected is not None and self._suspected is None and _is_near(self._expected[0], T_wc)

    def confirm(self, T_wc: Array) -> Cells | None:
        """What `segment` would give for the view that was expected, if its pose (4, 4) is about the predicted one; None: it is not."""
        if self._expected is None or not self.expects(T_wc):
            return None
        self._number += 1
        segmented, through = self._expected
        self._learn_left(segmented.view, T_wc)
        self._keep(replace(segmented, T_wc=T_wc), through)
        return segmented.moving

    def segment(self, view: CoarseView, T_wc: Array) -> Cells:
        """(h, w) the cells of a view at a pose (4, 4) that show what moves."""
        self._number += 1
        segmented, through = self._judged(view, T_wc, self._number, self._followed(view, T_wc, self._number))
        self._keep(segmented, through)
        return segmented.moving

    def _keep(self, segmented: Segmented, through: dict[int, Cells]) -> None:
        self._last, self._suspected, self._expected = segmented, None, None
        self._witnesses.prove(through, segmented.moving)

    def _judged(self, view: CoarseView, T_wc: Array, number: int, near_left: list[Cells]) -> tuple[Segmented, dict[int, Cells]]:
        """What moves in a view of this number, and the cells (h, w) that other views saw through. near_left: where something left."""
        asked = self._witnesses.asked(T_wc, number, [self.recent, self.keyframes], moves=not self.still)
        found = votes(view, T_wc, list(asked.values()))
        near, before = self._carried_with_ages(view.camera, T_wc)
        carried_on = np.abs(view.depth - near) < _SAME
        pauses = carried_on & (found.through > 0) & ~found.stands  # one who stands still where views of her have gathered
        scene = self._scene(found, found.moves | pauses, view)
        goes_on = carried_on & (~(found.held | scene) | (before < 0))
        stays = (found.held | scene | (found.stays & ~carried_on)) & ~pauses
        followed = np.logical_or.reduce([np.zeros_like(stays), *near_left]) & ~found.stays & ~scene
        fresh = grown(found.moves | pauses | followed, stays, view.depth, _WHOLE) | followed
        age = np.where(goes_on, before + 1, _LASTS + 1)
        age = np.where(fresh, np.minimum(age, 0), age)
        if self._suspected is not None:
            age[self._suspected] = -_SUSPECTED
        age = np.where(view.depth > 0, age, self._blind(view, age <= _LASTS))
        return Segmented(view, T_wc, age <= _LASTS, age.astype(np.int32)), dict(zip(asked, found.by))

    def _blind(self, view: CoarseView, moving: Cells) -> Ages:
        """(h, w) [frames] the ages of the holes of a view that show a body nearer than the sensor reads."""
        before = np.full(moving.shape, NEVER, np.int32)
        if self._last is not None:
            holes = self._last.moving & (self._last.view.depth <= 0)
            before[holes] = self._last.age[holes]
        return blind(view.depth, moving, before)

    def _scene(self, found: Votes, moves: Cells, view: CoarseView) -> Cells:
        """(h, w) the cells of a view that go on from what is held, where nothing was seen through: such as what a body uncovers."""
        if self.still or self._suspected is not None:
            return np.zeros_like(moves)
        return continued(found.held & ~moves, ~moves & (found.through == 0), view.depth) & ~moves

    def _carried(self, camera: Camera, T_wc: Array) -> NDArray[np.float32]:
        """(h, w) [m] the depth at which a camera would see what moved last; infinite elsewhere."""
        if self._last is None:
            return np.full((camera.height, camera.width), np.float32(np.inf))
        return carried(self._last.view, self._last.T_wc, self._last.moving, camera, T_wc)

    def _carried_with_ages(self, camera: Camera, T_wc: Array) -> tuple[NDArray[np.float32], Ages]:
        """`_carried`, and the ages of its cells."""
        if self._last is None:
            return self._carried(camera, T_wc), np.zeros((camera.height, camera.width), np.int32)
        return carried_with_ages(self._last.view, self._last.T_wc, self._last.moving, self._last.age, camera, T_wc)

    def _followed(self, view: CoarseView, T_wc: Array, number: int) -> list[Cells]:
        """(h, w) each: the cells near the places that something has left since the recent views. One of them learns what has left."""
        self._learn_left(view, T_wc)
        return self._all_near_left(view, T_wc, number)

    def _learn_left(self, view: CoarseView, T_wc: Array) -> None:
        """One recent view a frame learns what a view at a pose (4, 4) saw through: the newest, then another one in turns."""
        if not self.recent:
            return
        newest = len(self.recent) - 1
        look = newest if self._turn % 2 else self._turn // 2 % max(newest, 1)
        kept = self.recent[look]
        found = votes(kept.view, self._pose(kept), [PosedView(view, T_wc, np.zeros(view.depth.shape, np.bool_))])
        left = grown(found.moves, found.stays, kept.view.depth)
        self.recent[look] = replace(kept, left=kept.left | left, moving=kept.moving | left)

    def _all_near_left(self, view: CoarseView, T_wc: Array, number: int) -> list[Cells]:
        """What `_near_left` gives for every other recent view, in turns."""
        looked = self.recent[number % _TURNS :: _TURNS]
        return [near for kept in looked if (near := self._near_left(kept, view, T_wc)) is not None]

    def _near_left(self, kept: Remembered, view: CoarseView, T_wc: Array) -> Cells | None:
        """(h, w) the cells of a view at a pose (4, 4) near the places that something has left since a recent view; None: nothing has."""
        if not kept.left.any():
            return None
        return np.asarray(np.abs(view.depth - carried(kept.view, self._pose(kept), kept.left, view.camera, T_wc)) < _FOLLOWED)

    def _pose(self, kept: Remembered) -> Array:
        return np.asarray(self._pose_of(kept.host) @ kept.T_kc)

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
        """What moved is not known any more: the camera was lost, or its pose is not exact enough to tell."""
        self._last = self._expected = None

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
            for k in range(self._number % _TURNS, len(self.recent), _TURNS):
                kept = self.recent[k]
                near = self._carried(kept.view.camera, self._pose_of(kept.host) @ kept.T_kc)
                self.recent[k] = replace(kept, moving=kept.moving | (np.abs(kept.view.depth - near) < _AT_PLACE))

    def look_back(self, host: int) -> Cells | None:
        """The moving cells of a remembered keyframe, if what moves now is at a place that it shows: then it shows the same body."""
        for k in range(len(self.keyframes) - 1, max(len(self.keyframes) - 1 - _BACK, -1), -1):
            kept = self.keyframes[k]
            if kept.host != host or self._last is None or not self._last.moving.any():
                continue
            near = self._carried(kept.view.camera, self._pose_of(host))
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
        near = np.flatnonzero(self._witnesses.see(self.keyframes, self._last.T_wc))
        if not len(near):
            return None
        turn = near[self._turn // _AGAIN % len(near)]
        kept = self.keyframes[turn]
        T_wc = self._pose_of(kept.host)
        found = votes(kept.view, T_wc, list(self._witnesses.nearest(T_wc, kept.number, [self.recent]).values()))
        left = kept.left | grown(found.moves, found.stays, kept.view.depth)
        moving = (kept.moving & ~found.held) | left
        if (moving != kept.moving).sum() < _NEWS:
            return None
        self.keyframes[turn] = replace(kept, moving=moving, left=left)
        return kept.host, moving

    def state(self) -> State:
        """The remembered views, and what moved in the last one."""
        views = {name: [kept.state() for kept in getattr(self, name)] for name in ("keyframes", "recent")}
        last = None if self._last is None else self._last.state()
        return {**views, "last": last, "counts": [self._turn, self._since, self._number], "proven": list(self._witnesses.proven)}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.keyframes, self.recent = ([Remembered.from_state(kept) for kept in state[name]] for name in ("keyframes", "recent"))
        self._last = None if state["last"] is None else Segmented.from_state(state["last"])
        self._turn, self._since, self._number = state["counts"]
        self._witnesses.proven = list(state["proven"])


def _is_near(segmented: Segmented, T_wc: Array) -> bool:
    """Whether a view is segmented alike at a pose (4, 4): its cells' points move by less than a share of a cell, and of the slack."""
    turn = np.linalg.norm(segmented.T_wc[:3, :3] - T_wc[:3, :3]) / np.sqrt(2)  # [rad] for small angles
    shift = np.linalg.norm(segmented.T_wc[:3, 3] - T_wc[:3, 3])
    return bool(turn * segmented.view.camera.fx < _OFF and shift < _OFF * SLACK)
