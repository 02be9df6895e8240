"""Segmentation of what moves, view by view: by the free space that remembered views saw, carried on with the camera from view to view.

A view is segmented at its predicted pose first. If its tracked pose is about that one, what was found holds; else it is segmented again.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.segmentation.blind_zone import blind
from idfslam.segmentation.carrying import carried_with_ages
from idfslam.segmentation.coarse_view import CoarseView
from idfslam.segmentation.constants import NEVER, SLACK
from idfslam.segmentation.free_space import Votes, votes
from idfslam.segmentation.memory import Memory
from idfslam.segmentation.region_growing import grown
from idfslam.segmentation.remembered import Segmented
from idfslam.segmentation.smooth_continuation import continued
from idfslam.storage.state import State, Stateful

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]
Ages = NDArray[np.int32]

# All of them were chosen by hand on generated rooms.
_SAME = 0.15  # [m] depth by which a carried cell may change. More: what a person uncovers is masked a little longer
_SUSPECTED = 20  # [frames] that a cell stays masked longer after tracking has told that it moves. More: likewise
# Share of a cell, and of the slack, by which a predicted pose may be off. More: more views need no second segmentation, with rougher masks
_OFF = 0.3
# [frames] that a cell stays masked while nothing tells that it stays. More: who stands where no view saw through stays masked for longer,
# and false masks do. 60 gave no more
_LASTS = 30
# [cells] that a region of the newest view grows from what was seen through and what follows what has left: a part that is missed draws the
# pose. With 8 cells 2.1 % of the images of rooms 0, 4 and 6 were missed and 1.1 % masked wrongly, with 16 cells 1.4 and 1.3 %. More: the
# same
_WHOLE = 16


class Segmenter(Stateful):
    """Finds the cells of each view that show what moves. Cells are (h, w), those of a `CoarseView`."""

    def __init__(self, memory: Memory) -> None:
        """memory: the views that each view is compared with. It learns what each view sees through."""
        self.memory = memory
        self.last: Segmented | None = None  # the view segmented last; None: the camera was lost, or nothing was segmented yet
        self._suspected: Cells | None = None  # cells of the next view that its tracking says to move
        self._predicted: tuple[Segmented, dict[int, Cells]] | None = None  # the next view at its predicted pose, and who saw through it

    @property
    def still(self) -> bool:
        """Whether nothing moves, as far as is known: not in the last view, and nothing has left its place since the recent ones."""
        return self.last is not None and not (self._suspected is not None or self.last.moving.any() or self.memory.knows_what_left)

    def predict(self, view: CoarseView, T_predicted: Array) -> Cells:
        """The cells that move if a view is at a predicted pose (4, 4). Nothing is known before the first view."""
        if self.last is None or self.still:
            self._predicted = None
            return np.zeros(view.depth.shape, np.bool_)
        near_left = self.memory.near_what_left(view, T_predicted, self.memory.frames)
        self._predicted = self._segmented(view, T_predicted, self.memory.frames + 1, near_left)
        return self._predicted[0].moving

    def preview(self, view: CoarseView, T_tracked: Array) -> Cells:
        """What `segment` would give for a view at a pose (4, 4), which may be found wrong yet: the memory learns nothing."""
        recent = list(self.memory.recent)
        self._predicted = self._segmented(view, T_tracked, self.memory.frames + 1, self._followed(view, T_tracked, self.memory.frames + 1))
        self.memory.recent = recent
        return self._predicted[0].moving

    def is_predicted(self, T_wc: Array) -> bool:
        """Whether what was found at the predicted pose holds at a pose (4, 4) too."""
        return self._predicted is not None and self._suspected is None and _is_near(self._predicted[0], T_wc)

    def confirm(self, T_wc: Array) -> Cells | None:
        """What `segment` would give for the predicted view at its tracked pose (4, 4), if that is near the predicted one; else None."""
        if self._predicted is None or not self.is_predicted(T_wc):
            return None
        self.memory.frames += 1
        segmented, through = self._predicted
        self.memory.learn_what_left(segmented.view, T_wc)
        return self._keep(replace(segmented, T_wc=T_wc), through)

    def segment(self, view: CoarseView, T_wc: Array) -> Cells:
        """The cells of a view at a pose (4, 4) that show what moves."""
        self.memory.frames += 1
        return self._keep(*self._segmented(view, T_wc, self.memory.frames, self._followed(view, T_wc, self.memory.frames)))

    def suspect(self, cells: Cells) -> None:
        """Takes cells of the view that is segmented next for moving, and for a while what is carried on from them."""
        self._suspected = cells

    def forget_last(self) -> None:
        """What moved is not known any more: the camera was lost, or its pose is not exact enough to tell."""
        self.last = self._predicted = None

    def _keep(self, segmented: Segmented, through: dict[int, Cells]) -> Cells:
        self.last, self._suspected, self._predicted = segmented, None, None
        self.memory.prove(through, segmented.moving)
        return segmented.moving

    def _followed(self, view: CoarseView, T_wc: Array, number: int) -> Cells:
        """The cells near the places that something has left, by this view too."""
        self.memory.learn_what_left(view, T_wc)
        return self.memory.near_what_left(view, T_wc, number)

    def _segmented(self, view: CoarseView, T_wc: Array, number: int, near_left: Cells) -> tuple[Segmented, dict[int, Cells]]:
        """A view of this number, and for each other view, by its number, the cells that it saw through. near_left: what may have left."""
        others = self.memory.witnesses(T_wc, number, moves=not self.still)
        found = votes(view, T_wc, list(others.values()))
        depth_before, age_before = self._carried(view.camera, T_wc)
        moved_before = np.abs(view.depth - depth_before) < _SAME
        pauses = moved_before & (found.through > 0) & ~found.stands  # one who stands still where views of her have gathered
        scene = self._continued_scene(found, found.moves | pauses, view)
        # Evidence that a cell moves, that it stays, and that what moved before goes on
        followed = near_left & ~found.stays & ~scene
        stays = (found.held | scene | (found.stays & ~moved_before)) & ~pauses
        moves = grown(found.moves | pauses | followed, stays, view.depth, _WHOLE) | followed
        goes_on = moved_before & (~(found.held | scene) | (age_before < 0))
        age = np.where(goes_on, age_before + 1, _LASTS + 1)
        age = np.where(moves, np.minimum(age, 0), age)
        if self._suspected is not None:
            age[self._suspected] = -_SUSPECTED
        age = np.where(view.depth > 0, age, self._blind(view, age <= _LASTS))
        return Segmented(view, T_wc, age <= _LASTS, age.astype(np.int32)), dict(zip(others, found.by))

    def _carried(self, camera: Camera, T_wc: Array) -> tuple[NDArray[np.float32], Ages]:
        """The depth [m] at which a camera would see what moved last, infinite elsewhere; and the ages [frames] of its cells."""
        if self.last is None:
            shape = camera.height, camera.width
            return np.full(shape, np.float32(np.inf)), np.zeros(shape, np.int32)
        return carried_with_ages(self.last.view, self.last.T_wc, self.last.moving, self.last.age, camera, T_wc)

    def _continued_scene(self, found: Votes, moves: Cells, view: CoarseView) -> Cells:
        """The cells of a view that go on from what is held, where nothing was seen through: such as what a body uncovers."""
        if self.still or self._suspected is not None:
            return np.zeros_like(moves)
        return continued(found.held & ~moves, ~moves & (found.through == 0), view.depth) & ~moves

    def _blind(self, view: CoarseView, moving: Cells) -> Ages:
        """The ages [frames] of the holes of a view that show a body nearer than the sensor reads."""
        before = np.full(moving.shape, NEVER, np.int32)
        if self.last is not None:
            holes = self.last.moving & (self.last.view.depth <= 0)
            before[holes] = self.last.age[holes]
        return blind(view.depth, moving, before)

    def state(self) -> State:
        """What moved in the last view."""
        return {"last": None if self.last is None else self.last.state()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.last = None if state["last"] is None else Segmented.from_state(state["last"])


def _is_near(segmented: Segmented, T_wc: Array) -> bool:
    """Whether a view is segmented alike at a pose (4, 4): its cells' points move by less than a share of a cell, and of the slack."""
    turn = np.linalg.norm(segmented.T_wc[:3, :3] - T_wc[:3, :3]) / np.sqrt(2)  # [rad] for small angles
    shift = np.linalg.norm(segmented.T_wc[:3, 3] - T_wc[:3, 3])
    return bool(turn * segmented.view.camera.fx < _OFF and shift < _OFF * SLACK)
