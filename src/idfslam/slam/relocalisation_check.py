"""Verifies a relocalisation afterwards: two places can look alike for metres, but not for ever.

What is mapped after a relocalisation stays apart from older keyframes until the camera has gone some way and still sees what it should.
If the images of old keyframes contradict it instead, it was another place, and what was mapped since becomes a submap of its own.
"""

import logging
from typing import Any

from idfslam.alignment.aligner import Aligner
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.path_length import distances
from idfslam.slam.keyframe_hook import KeyframeHook, Moved
from idfslam.storage.state import State

log = logging.getLogger(__name__)

_CONFIRMED_AFTER = 3.0  # [m], turns as the shift 2 m ahead: a keyframe this far on that agrees confirms the place. More: later, and safer
_WITNESSES = 4  # old keyframes compared with a new one; more: fewer wrong contradictions, at a comparison of images each
_MIN_IN_VIEW = 0.3  # share of an old keyframe's landmarks in view from which it says something
_CONTRADICTION = 1.4  # photometric error over the doubtful one from which an old keyframe contradicts; more: fewer places are refuted
_CONTRADICTIONS = 2  # contradicted keyframes in a row that refute a place; more: fewer and later refutations


class RelocalisationCheck(KeyframeHook):
    """Compares the keyframes since a relocalisation with older ones."""

    def __init__(self, aligner: Aligner, graph: KeyframeGraph, frames: FramePoses) -> None:
        self.aligner, self.graph, self.frames = aligner, graph, frames
        self.max_error = 0.0  # photometric error above which an old keyframe contradicts
        self.contradictions = 0  # keyframes in a row that were contradicted
        self.refuted = 0  # relocalisations that were undone

    def state(self) -> State:
        """The counts and the limit."""
        return {"max_error": self.max_error, "contradictions": self.contradictions, "refuted": self.refuted}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.max_error, self.contradictions, self.refuted = state["max_error"], state["contradictions"], state["refuted"]

    def figures(self) -> dict[str, Any]:
        return {"relocalisations_refuted": self.refuted}

    def begin(self) -> None:
        """The camera was relocalised just now."""
        self.max_error, self.contradictions = _CONTRADICTION * self.aligner.doubtful_brightness, 0

    def on_keyframe(self, keyframe: Keyframe) -> Moved:
        if not self.contradicted(keyframe):
            return Moved()
        log.info("frame %d contradicts the last relocalisation: what was mapped since becomes a submap of its own", keyframe.index)
        first = self.graph.unverified_from
        assert first is not None
        seemingly_covisible = self.graph.split_off()
        self.frames.undo_interpolation_before(first)
        of_submap = [other for other in self.graph.keyframes if other.submap == keyframe.submap]
        return Moved([*seemingly_covisible, *of_submap], submap=True, split=True)

    def contradicted(self, keyframe: Keyframe) -> bool:
        """Whether a keyframe just inserted refutes the relocalisation; if it confirms it instead, the check ends."""
        first = self.graph.unverified_from
        if first is None:
            return False
        witnesses = [self.graph.keyframes[i] for i in keyframe.covisible_references if i < first][:_WITNESSES]
        compared = [self.aligner.compare(keyframe, witness, keyframe.T_wk) for witness in witnesses]
        errors = [error for in_view, error in compared if in_view > _MIN_IN_VIEW]
        if not errors:
            return False
        agrees = min(errors) <= self.max_error
        self.contradictions = 0 if agrees else self.contradictions + 1
        way = distances(self.graph.keyframes[first].T_wk[None].numpy(), keyframe.T_wk[None].numpy())[0]
        if agrees and way > _CONFIRMED_AFTER:
            self.graph.confirm()
        if self.contradictions < _CONTRADICTIONS:
            return False
        self.refuted += 1
        return True
