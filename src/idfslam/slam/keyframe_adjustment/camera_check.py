"""Whether the camera is as stated: some keyframes are adjusted together with it, early in a run and at its end, and doubts are told.

Nothing else of the run depends on it. The early check runs beside the frames, and tells doubts that the user may act on at once.
"""

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from idfslam.adjustment.camera_findings import doubts
from idfslam.adjustment.camera_model import NAMES
from idfslam.adjustment.landmark_tracks import KeyframeView
from idfslam.adjustment.self_calibration import CameraEstimate, PosedViews, self_calibrate
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.keyframe_adjustment.keyframe_motion import KeyframeMotions
from idfslam.slam.keyframe_hook import KeyframeHook, Moved

log = logging.getLogger(__name__)
Array = NDArray[np.float64]
Found = TypeVar("Found")

_EARLY = 12  # stored keyframes at the early check; more: surer and later. This and the rest: chosen by hand
_STRETCH = 12  # keyframes in a row that are checked together; more: surer, slower
_STRETCHES = 2  # such stretches at the end of a run, one of them its last keyframes; more: surer, slower


class CameraCheck(KeyframeHook):
    """Says whether the camera fits the views. See `figures` for what it found at the end."""

    def __init__(self, graph: KeyframeGraph, motions: KeyframeMotions, time_sigmas: Callable[[Keyframe], Array]) -> None:
        """motions: with the likeliest times of rows. time_sigmas: standard deviations (3,) [s] of these times."""
        self.graph, self.motions, self.time_sigmas = graph, motions, time_sigmas
        self._early: Future[bool] | None = None  # the early check; True: it told doubts
        self._final: Future[CameraEstimate | None] | None = None  # that at the end of the run
        self._estimate: CameraEstimate | None = None  # of the latter

    def on_keyframe(self, keyframe: Keyframe) -> Moved:
        """Starts the early check."""
        if len(self.graph.keyframes) == _EARLY and keyframe.host == _EARLY - 1 and self._early is None:
            self._early = _beside(_told, self._posed_views(self.graph.keyframes))
        return Moved()

    def on_finish(self) -> None:
        """Starts the check of the first keyframes of the largest submap and its last ones, beside the fusion of depth."""
        (largest, _), *_ = Counter(keyframe.submap for keyframe in self.graph.keyframes).most_common(1)
        keyframes = [keyframe for keyframe in self.graph.keyframes if keyframe.submap == largest]
        starts = np.unique(np.linspace(0, max(len(keyframes) - _STRETCH, 0), _STRETCHES).round().astype(int)).tolist()
        chosen = sorted({i for start in starts for i in range(start, min(start + _STRETCH, len(keyframes)))})
        self._final = _beside(_estimated, self._posed_views([keyframes[i] for i in chosen]))

    def _posed_views(self, keyframes: Sequence[Keyframe]) -> PosedViews:
        """The views of keyframes with depth, at their present poses."""
        kept = [keyframe for keyframe in keyframes if keyframe.has_depth]
        poses = np.array([keyframe.T_wk.numpy() for keyframe in kept])
        sigmas = self.time_sigmas(kept[-1]) if kept else np.zeros(3)
        views, motions = [KeyframeView.of(keyframe.frame) for keyframe in kept], [self.motions.of(keyframe) for keyframe in kept]
        return PosedViews(views, poses, motions, sigmas)

    def settle(self) -> None:
        """Tells doubts that the early check did not tell yet."""
        self._estimate = None if self._final is None else self._final.result()
        if self._estimate is not None and not (self._early is not None and self._early.result()):
            _tell(self._estimate)

    def figures(self) -> dict[str, Any]:
        """`camera_doubts`, what is wrong with the camera, and `camera_deviations` of its values; empty before the end of a run."""
        e = self._estimate
        if e is None:
            return {}
        columns = zip(NAMES, e.model.values.tolist(), e.sigmas.tolist())
        deviations = {name: {"value": value, "sigma": sigma} for name, value, sigma in columns if sigma > 0}
        return {"camera_doubts": doubts(e), "camera_deviations": deviations}


def _beside(check: Callable[[PosedViews], Found], views: PosedViews) -> "Future[Found]":
    """Runs a check in a thread of its own."""
    pool = ThreadPoolExecutor(1, "camera-check")
    running = pool.submit(check, views)
    pool.shutdown(wait=False)
    return running


def _estimated(views: PosedViews) -> CameraEstimate | None:
    """The camera that fits; None if none is to be believed. Only a camera in doubt is searched for more exactly."""
    estimate = self_calibrate([views], rounds=1, explained=True)
    if estimate is not None and estimate.explains_images and doubts(estimate):
        estimate = self_calibrate([views], rounds=1, start=estimate, explained=True)
    return estimate if estimate is not None and estimate.explains_images else None


def _told(views: PosedViews) -> bool:
    """Checks the camera, and says whether doubts were told."""
    estimate = _estimated(views)
    return estimate is not None and _tell(estimate)


def _tell(estimate: CameraEstimate) -> bool:
    found = doubts(estimate)
    if found:
        log.warning("the camera does not fit the images: %s; `idf-slam calibrate RECORDING --out camera.json` mends it", "; ".join(found))
    return bool(found)
