"""What moves before the camera: the pixels of a frame that show it take no part in tracking, in the map and in anything else.

A view is segmented at its predicted pose before it is tracked, and again once its pose is known if that is another one
(`idfslam.segmentation.segmenter`). Stored keyframes are masked later, too, where later views have seen through what they show.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from idfslam.frame import Status
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.segmentation.coarse_view import CoarseView, cells_camera, coarse_view, in_pixels, thinned
from idfslam.segmentation.image_standstill import without as without_cells
from idfslam.segmentation.memory import Memory
from idfslam.segmentation.segmenter import Segmenter
from idfslam.sensing.rectification import rectified
from idfslam.slam.front_end.front_end import FrontEnd
from idfslam.slam.motion_segmentation.carried_layer import CarriedLayer
from idfslam.slam.motion_segmentation.nearest_layer_trial import NearestLayerTrial
from idfslam.slam.motion_segmentation.tracked_without import tracked_without
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Source, Tracked
from idfslam.storage.state import State, Stateful

# [1] Share of the readings that show what moves from which a pose is called degenerate: little of the scene is left, and a body that is
# not recognised outweighs it. More: fewer frames are told. Chosen by hand.
_CROWDED = 0.6
# [1] Share of the readings that a view was tracked by from which it is tracked again if they turn out to move at its pose. More: faster,
# and a body that was not expected there draws poses. Chosen by hand: in a generated room 9 and 20 % drew the pose by 2 and 9 cm.
_MORE = 0.05
# [1] How far a body drew the frame before one in which it is found along, over how far it drew that. Where people began to walk it was
# 0.60 to 0.68 (rooms 1, 3 and 6, and a hand-held camera). More: earlier frames are corrected by more.
_PULL_BEFORE = 0.64
# [frames] passed over between two that are segmented while nothing moves. More: faster, and what begins to move is found later.
_PASSED_OVER = 2


class MotionSegmentation(Stateful, ABC):
    """Finds what moves in each view."""

    @abstractmethod
    def predict(self, view: Keyframe) -> None:
        """Hides what moves in a view at its predicted pose."""

    @abstractmethod
    def check(self, view: Keyframe, tracked: Tracked, front_end: FrontEnd) -> Tracked:
        """Checks the result of tracking a view: did something that moves draw the pose away? Then the front end tracks it again."""

    @abstractmethod
    def segment(self, view: Keyframe, tracked: Tracked) -> Tracked:
        """Hides what moves in a view whose pose was tracked; returns the result, whose status may change."""

    @abstractmethod
    def remember(self, view: Keyframe, tracked: Tracked) -> None:
        """Called after a view was added to the frames, and to the graph if it is a keyframe."""


class NoSegmentation(MotionSegmentation):
    """Everything is taken for static."""

    def predict(self, view: Keyframe) -> None:
        """Leaves the view as it is."""

    def check(self, view: Keyframe, tracked: Tracked, front_end: FrontEnd) -> Tracked:
        return tracked

    def segment(self, view: Keyframe, tracked: Tracked) -> Tracked:
        return tracked

    def remember(self, view: Keyframe, tracked: Tracked) -> None:
        """Remembers nothing."""


class FreeSpaceSegmentation(MotionSegmentation):
    """What lies in space that earlier views saw through moves; so does what later views see through."""

    def __init__(
        self,
        frames: FramePoses,
        timer: StageTimer,
        masked: Callable[[Keyframe], None],
        references: Callable[[], Sequence[Keyframe]],
    ) -> None:
        """masked: is called with a stored keyframe whose mask has changed. references: the keyframes that frames are tracked against."""
        self.frames, self.graph, self.timer, self._masked, self._references = frames, frames.graph, timer, masked, references
        self.memory = Memory(lambda host: frames.graph.keyframes[host].T_wk.numpy())
        self.segmenter = Segmenter(self.memory)
        self.trial, self.carried = NearestLayerTrial(), CarriedLayer(frames)
        self._passed_over = 0  # frames since one was segmented
        self.found = False  # whether anything has moved so far

    def state(self) -> State:
        """Whether anything was found, and the number of frames since one was segmented."""
        return {"found": self.found, "passed_over": self._passed_over}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.found, self._passed_over = state["found"], state["passed_over"]

    def check(self, view: Keyframe, tracked: Tracked, front_end: FrontEnd) -> Tracked:
        """Leaves the nearest layer out, on trial, of a view whose image fits worse than usual, and what was not expected to move.

        A layer that moves has drawn the frames before along, too: the farther, the later. They are moved back.
        """
        without, carried = self.carried.run(view, tracked, front_end, lambda: _as_taken(view))
        if carried is not None:
            for keyframe in self._references():
                self.hide(keyframe, in_pixels(self.carried.cells(_as_taken(keyframe)), keyframe.camera))
            self.frames.correct_latest(tracked.T_wc, without.T_wc, _PULL_BEFORE)
            return without
        without, moves = self.trial.run(view, tracked, front_end, lambda: self._scene(view).depth)
        if moves is not None:
            self.segmenter.suspect(moves)
            if not tracked.is_lost:
                self.frames.correct_latest(tracked.T_wc, without.T_wc, _PULL_BEFORE)
            return without
        return self._without_more(view, tracked, front_end)

    def _without_more(self, view: Keyframe, tracked: Tracked, front_end: FrontEnd) -> Tracked:
        """The result for a view, tracked again if much of what it was tracked by turns out to move at its pose."""
        if tracked.is_lost or tracked.source is Source.REGISTERED:
            return tracked
        if self.segmenter.still or self.segmenter.is_predicted(tracked.T_wc.numpy()):
            return tracked
        with self.timer.stage("segment"):
            more = in_pixels(self.segmenter.preview(self._scene(view), tracked.T_wc.numpy()), view.camera)
        shown = view.frame.depth > 0
        if np.count_nonzero(more & shown) < _MORE * np.count_nonzero(shown):
            return tracked
        again, undo = tracked_without(more, view, front_end)
        if again.is_lost or front_end.misfit(view, again.T_wc) > front_end.misfit(view, tracked.T_wc):
            undo()
            return tracked
        return again

    def predict(self, view: Keyframe) -> None:
        with self.timer.stage("segment"):
            if self.carried.is_known:
                self.carried.follow(_as_taken(view))
            self._hide(view, None if self.segmenter.still else self.segmenter.predict(self._scene(view), view.T_wk.numpy()))

    def segment(self, view: Keyframe, tracked: Tracked) -> Tracked:
        self.carried.accept(view.index, lambda: _as_taken(view), lost=tracked.is_lost)
        if tracked.is_lost:
            self.segmenter.forget_last()
            self._hide(view, None)
            return tracked
        self.trial.accept(tracked)
        if tracked.source is Source.REGISTERED:  # such poses are off by up to a centimetre and a degree, which would pass for movement
            self.segmenter.forget_last()
            return tracked
        doubtful = tracked.status is Status.DOUBTFUL  # at a wrong pose, the scene itself seems to move
        if self.segmenter.still and (doubtful or self._passed_over < _PASSED_OVER):
            self._passed_over = min(self._passed_over + 1, _PASSED_OVER)
            self.memory.pass_over()
            self._hide(view, None)
            return tracked
        self._passed_over = 0
        with self.timer.stage("segment"):
            T_wc = tracked.T_wc.numpy()
            cells = self.segmenter.confirm(T_wc) if view.rectification_of_taken is None else None
            if cells is None:
                cells = self.segmenter.segment(self._scene(view), T_wc)
            self._hide(view, cells)
            self.found |= bool(cells.any())
            self.memory.mask_in_recent(self.segmenter.last)
            for keyframe in self._references():
                if (shown := self.memory.mask_in_keyframe(keyframe.host, self.segmenter.last)) is not None:
                    self._mask(keyframe, shown)
            return crowded(view, tracked)

    def hide(self, keyframe: Keyframe, pixels: NDArray[np.bool_]) -> None:
        """Hides more pixels (H, W) of a stored keyframe."""
        keyframe.hide(pixels if keyframe.moving is None else pixels | keyframe.moving)
        self._masked(keyframe)

    def _mask(self, keyframe: Keyframe, cells: NDArray[np.bool_]) -> None:
        self._hide(keyframe, cells)
        self._masked(keyframe)

    def _hide(self, view: Keyframe, moving: NDArray[np.bool_] | None) -> None:
        """Hides cells (h, w) of a view, and what the camera carries along."""
        cells = self.carried.cells(_as_taken(view)) if self.carried.is_known else None
        cells = moving if cells is None else cells if moving is None else cells | moving
        view.hide(None if cells is None or not cells.any() else in_pixels(cells, view.camera))

    def _scene(self, view: Keyframe) -> CoarseView:
        """The coarse view of all that a view shows, but for what the camera carries along."""
        coarse = _coarse(view)
        return without_cells(coarse, self.carried.cells(_as_taken(view))) if self.carried.is_known else coarse

    def remember(self, view: Keyframe, tracked: Tracked) -> None:
        if not self.graph.keyframes or not tracked.status.trusted or tracked.source is Source.REGISTERED:
            return
        with self.timer.stage("segment"):
            stored = self.graph.is_stored(view)
            if self._passed_over and not stored:
                return
            if self._passed_over and (cells := self.segmenter.segment(self._scene(view), view.T_wk.numpy())).any():
                self._mask(view, cells)
            host, T_kc = self.graph.relative_to_host(view.T_wk)
            place = (view.host, np.eye(4)) if stored else (host, T_kc.numpy())
            self.memory.add(self.segmenter.last, *place, stored=stored)
            if (news := self.memory.segment_again(self.segmenter.last)) is not None:
                self._mask(self.graph.keyframes[news[0]], news[1])


def _as_taken(view: Keyframe) -> CoarseView:
    """The coarse view of all that a view shows, as it was taken: what the camera carries along is not bent by its motion."""
    frame = view.taken_unmasked.frame
    return replace(coarse_view(frame.depth, frame.colour, frame.camera), camera=cells_camera(view.camera))


def _coarse(view: Keyframe) -> CoarseView:
    """The coarse view of all that a view shows. Most frames are never rectified, so those pixels that it reads are rectified alone."""
    rectification, frame = view.rectification_of_taken, view.taken_unmasked.frame
    if rectification is not None:
        frame = rectified(thinned(frame), rectification)
    return replace(coarse_view(frame.depth, frame.colour, frame.camera), camera=cells_camera(view.camera))


def crowded(view: Keyframe, tracked: Tracked) -> Tracked:
    """The result for a view: degenerate, with a larger covariance, if what moves leaves little of it."""
    if view.moving is None:
        return tracked
    shown = view.moving | (view.taken_unmasked.frame.depth > 0)
    share = np.count_nonzero(view.moving) / np.count_nonzero(shown)
    if share < _CROWDED or tracked.status is not Status.OK:
        return tracked
    covariance = None if tracked.covariance is None else tracked.covariance / (1 - share) ** 2
    return replace(tracked, status=Status.DEGENERATE, covariance=covariance)
