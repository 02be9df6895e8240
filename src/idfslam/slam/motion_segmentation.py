"""What moves before the camera: the pixels of a frame that show it take no part in tracking, in the map and in anything else.

A view is segmented at its predicted pose before it is tracked, and again once its pose is known if that is another one
(`idfslam.segmentation.memory`). Stored keyframes are masked later, too, where later views have seen through what they show.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from idfslam.alignment.motion import image_motion
from idfslam.alignment.usual_error import UsualError
from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.segmentation.coarse_view import CoarseView, cells_camera, coarse_view, in_pixels, thinned
from idfslam.segmentation.memory import Memory
from idfslam.sensing.rectification import Rectification, rectified
from idfslam.slam.front_end import FrontEnd
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Tracked
from idfslam.storage.state import State, Stateful

# [1] Share of the readings that show what moves from which a pose is called degenerate: little of the scene is left, and a body that is
# not recognised outweighs it. More: fewer frames are told. Chosen by hand.
_CROWDED = 0.6
# [1] Photometric error, over the usual one, from which something may draw the pose away. More: it is noticed later, and tried less often.
_UNUSUAL = 1.15
# [1] Photometric error of what lies behind the nearest layer at the pose found without the layer, over that at the pose found with it, up
# to which the layer moves if this is so in two frames in a row. Where people began to walk it was 0.68 to 0.79; in redkitchen, where
# nothing moves, 0.79 once and else 0.85 and more. More: more layers move.
_BETTER = 0.8
# [1] Photometric error without the layer, over that with it, up to which the layer moves: in two frames in a row (likewise), and at once.
# In redkitchen it was 0.66 and more. The last one is over the usual error. More: more layers move.
_LESS, _FAR_LESS, _AS_USUAL = 0.76, 0.62, 1.1
_DRAWN = 0.0035  # [rad] motion of the image (0.2 degrees) by which the poses must differ then. More: weaker pulls are left alone
# [frames] before the next trial after one that did not help; twice as many after each further one, and one less after a frame that fits.
# More: faster, and movement is noticed later.
_WAITS, _MOST_WAITS = 1, 32
# [frames] passed over between two that are segmented while nothing moves. More: faster, and what begins to move is found later.
_PASSED_OVER = 2
_LAYER = 0.04, 0.7  # [1] least and largest share of the nearest layer. Wider: smaller and larger bodies are tried


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
        graph: KeyframeGraph,
        timer: StageTimer,
        masked: Callable[[Keyframe], None],
        references: Callable[[], Sequence[Keyframe]],
    ) -> None:
        """masked: is called with a stored keyframe whose mask has changed. references: the keyframes that frames are tracked against."""
        self.graph, self.timer, self._masked, self._references = graph, timer, masked, references
        self.memory = Memory(lambda host: graph.keyframes[host].T_wk.numpy())
        self._usual_error = UsualError(0.0, _UNUSUAL)
        self._waits = 0  # frames before the nearest layer is left out again on trial
        self._next_wait = _WAITS  # and after the next trial that does not help
        self._found_once = False  # whether the last frame told that its nearest layer moves
        self._passed_over = 0  # frames since one was segmented
        self.found = False  # whether anything has moved so far

    def state(self) -> State:
        """The remembered views, the usual photometric error, what was found, and the frames before the next trial and since the last."""
        counts = {"waits": [self._waits, self._next_wait], "found_once": self._found_once, "passed_over": self._passed_over}
        return {"memory": self.memory.state(), "usual_error": self._usual_error.state(), "found": self.found, **counts}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.memory.restore(state["memory"])
        self._usual_error.restore(state["usual_error"])
        (self._waits, self._next_wait), self._found_once, self._passed_over = state["waits"], state["found_once"], state["passed_over"]
        self.found = state["found"]

    def check(self, view: Keyframe, tracked: Tracked, front_end: FrontEnd) -> Tracked:
        """Leaves the nearest layer out, on trial, of a view whose image fits worse than usual: does the rest then fit better?"""
        error, self._waits = _photometric_error(tracked), max(self._waits - 1, 0)
        usual = self._usual_error
        if not usual.is_known or (usual.is_within(error, _UNUSUAL) and not tracked.is_lost):
            self._found_once = False
            self._next_wait = max(self._next_wait - usual.is_within(error, _AS_USUAL), _WAITS)
            return tracked
        if self._waits:
            return tracked
        layer, hidden = nearest_layer(_coarse(view).depth), view.moving
        if layer is None:
            return tracked
        pixels = in_pixels(layer, view.camera)
        before, undo = _Tried.of(view), front_end.undo()
        view.hide(pixels if hidden is None else pixels | hidden)
        without = front_end.track(view)
        once, again = self._found_once, self._is_drawn(view, tracked, without, front_end)
        if again and (once or self._is_clear(tracked, without)):
            self._found_once = False
            self.memory.suspect(layer)
            return without
        before.restore(view)
        undo()
        self._found_once = again
        if not again:
            self._waits, self._next_wait = self._next_wait, min(2 * self._next_wait, _MOST_WAITS)
        return tracked

    def _is_drawn(self, view: Keyframe, tracked: Tracked, without: Tracked, front_end: FrontEnd) -> bool:
        """Whether the layer, hidden in the view, drew the pose away: it is another one without, at which the rest fits much better."""
        found = without.status.trusted if tracked.is_lost else not without.is_lost
        if not (found and self._usual_error.is_within(_photometric_error(without), _AS_USUAL)):
            return False
        radius = 1.0 if without.alignment is None else without.alignment.radius
        if tracked.is_lost:
            return True
        if image_motion(tracked.T_wc, without.T_wc, radius) <= _DRAWN:
            return False
        if self._is_clear(tracked, without):
            return True
        less = _photometric_error(without) < _LESS * _photometric_error(tracked)
        return less and front_end.misfit(view, without.T_wc) < _BETTER * front_end.misfit(view, tracked.T_wc)

    def _is_clear(self, tracked: Tracked, without: Tracked) -> bool:
        """Whether one frame tells that the layer moves."""
        return tracked.is_lost or _photometric_error(without) < _FAR_LESS * (_photometric_error(tracked) or np.inf)

    def predict(self, view: Keyframe) -> None:
        with self.timer.stage("segment"):
            if self.memory.still:
                view.hide(None)
                return
            cells = self.memory.expect(_coarse(view), view.T_wk.numpy())
            view.hide(in_pixels(cells, view.camera) if cells.any() else None)

    def segment(self, view: Keyframe, tracked: Tracked) -> Tracked:
        if tracked.is_lost:
            self.memory.forget_last()
            view.hide(None)
            return tracked
        self._usual_error.accept(_photometric_error(tracked))
        if self.memory.still and self._passed_over < _PASSED_OVER:
            self._passed_over += 1
            self.memory.pass_over()
            view.hide(None)
            return tracked
        self._passed_over = 0
        with self.timer.stage("segment"):
            T_wc = tracked.T_wc.numpy()
            cells = self.memory.confirm(T_wc) if view.rectification_of_taken is None else None
            if cells is None:
                cells = self.memory.segment(_coarse(view), T_wc)
            view.hide(in_pixels(cells, view.camera) if cells.any() else None)
            self.found |= bool(cells.any())
            self.memory.look_back_at_recent()
            for keyframe in self._references():
                if (shown := self.memory.look_back(keyframe.host)) is not None:
                    self._mask(keyframe, shown)
            return crowded(view, tracked)

    def hide(self, keyframe: Keyframe, pixels: NDArray[np.bool_]) -> None:
        """Hides more pixels (H, W) of a stored keyframe."""
        keyframe.hide(pixels if keyframe.moving is None else pixels | keyframe.moving)
        self._masked(keyframe)

    def _mask(self, keyframe: Keyframe, cells: NDArray[np.bool_]) -> None:
        keyframe.hide(in_pixels(cells, keyframe.camera))
        self._masked(keyframe)

    def remember(self, view: Keyframe, tracked: Tracked) -> None:
        if not self.graph.keyframes or not tracked.status.trusted:
            return
        with self.timer.stage("segment"):
            stored = view.host < len(self.graph.keyframes) and self.graph.keyframes[view.host] is view
            if self._passed_over and not stored:
                return
            if self._passed_over and (cells := self.memory.segment(_coarse(view), view.T_wk.numpy())).any():
                self._mask(view, cells)
            host, T_kc = (view.host, np.eye(4)) if stored else _relative(*self.graph.relative_to_host(view.T_wk))
            self.memory.remember(host, T_kc, stored=stored)
            if (news := self.memory.look_again()) is not None:
                self._mask(self.graph.keyframes[news[0]], news[1])


@dataclass(frozen=True)
class _Tried:
    """What tracking sets in a view, to be restored after a trial that did not help."""

    hidden: NDArray[np.bool_] | None
    T_predicted: Tensor
    rectification: Rectification | None
    registered: bool

    @classmethod
    def of(cls, view: Keyframe) -> "_Tried":
        return cls(view.moving, view.T_wk.clone(), view.rectification, view.registered)

    def restore(self, view: Keyframe) -> None:
        view.hide(self.hidden)
        view.T_wk, view.registered = self.T_predicted, self.registered
        if self.rectification is not None and view.rectification is not self.rectification:
            view.rectify(self.rectification)


def _coarse(view: Keyframe) -> CoarseView:
    """The coarse view of all that a view shows. Most frames are never rectified, so those pixels that it reads are rectified alone."""
    if (rectification := view.rectification_of_taken) is None:
        frame = thinned(view.unmasked.frame)
    else:
        frame = rectified(thinned(view.taken_unmasked.frame), rectification)
    return replace(coarse_view(frame.depth, frame.colour, frame.camera), camera=cells_camera(view.camera))


def _relative(host: int, T_kc: object) -> tuple[int, NDArray[np.float64]]:
    return host, np.asarray(T_kc)


def crowded(view: Keyframe, tracked: Tracked) -> Tracked:
    """The result for a view: degenerate, with a larger covariance, if what moves leaves little of it."""
    if view.moving is None:
        return tracked
    readings = view.taken_unmasked.frame.depth > 0
    share = float((view.moving & readings).sum() / max(readings.sum(), 1))
    if share < _CROWDED or tracked.status is not Status.OK:
        return tracked
    covariance = None if tracked.covariance is None else tracked.covariance / (1 - share) ** 2
    return replace(tracked, status=Status.DEGENERATE, covariance=covariance)


def _photometric_error(tracked: Tracked) -> float:
    """[1] of the alignment that gave the pose; 0 if none did."""
    return 0.0 if tracked.alignment is None else tracked.alignment.photometric_error


def nearest_layer(depth: NDArray[np.float32]) -> NDArray[np.bool_] | None:
    """The near part (h, w) of depth (h, w) [m], split where the parts differ most (Otsu 1979, inverse depth); None: too small or large."""
    measured = depth > 0
    inverse = np.sort(1 / depth[measured])
    if len(inverse) < 2:
        return None
    count, total = np.arange(1, len(inverse)), inverse.cumsum()
    below, above = total[:-1] / count, (total[-1] - total[:-1]) / (len(inverse) - count)
    best = int((count * (len(inverse) - count) * (above - below) ** 2).argmax())
    layer = measured & (depth < 1 / inverse[best])
    return layer if _LAYER[0] <= layer.mean() <= _LAYER[1] else None
