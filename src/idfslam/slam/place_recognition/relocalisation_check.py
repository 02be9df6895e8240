"""Verification of a relocalisation by later keyframes: two places can look alike for metres, but not further.

After a relocalisation new keyframes are kept separate from older ones, until the camera has moved on and the images of old keyframes
confirm the place. If these images contradict it, the relocalisation was wrong, and the keyframes since become a submap of their own.
"""

import logging
from typing import Any

from idfslam.alignment.aligner import MapAligner
from idfslam.alignment.alignment import TELLING_SHARE
from idfslam.geometry.pose_distance import pose_distances
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.keyframe_hook import KeyframeHook, Moved
from idfslam.storage.state import State

log = logging.getLogger(__name__)

# All of these were chosen by hand.

# [m] Distance from the relocalisation, with a turn as the shift 2 m ahead, from which an agreeing keyframe confirms it. More: later, safer.
_CONFIRMED_AFTER = 3.0
_WITNESSES = 4  # old keyframes compared with a new one. More: fewer wrong contradictions, at a comparison of images each
_CONTRADICTION = 1.4  # [1] ratio of the photometric error to the doubtful one that is a contradiction. More: fewer refutations
_CONTRADICTIONS = 2  # contradicted keyframes in a row that refute a relocalisation. More: fewer and later refutations


class RelocalisationCheck(KeyframeHook):
    """Compares the keyframes since a relocalisation with older ones."""

    def __init__(self, aligner: MapAligner, graph: KeyframeGraph, frames: FramePoses) -> None:
        self.aligner, self.graph, self.frames = aligner, graph, frames
        self.max_error = 0.0  # largest photometric error to an old keyframe that does not contradict
        self.contradictions = 0  # number of contradicted keyframes in a row
        self.refuted = 0  # number of refuted relocalisations

    def state(self) -> State:
        """The counts and the limit."""
        return {"max_error": self.max_error, "contradictions": self.contradictions, "refuted": self.refuted}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.max_error, self.contradictions, self.refuted = state["max_error"], state["contradictions"], state["refuted"]

    def figures(self) -> dict[str, Any]:
        return {"relocalisations_refuted": self.refuted}

    def begin(self) -> None:
        """Starts the check, after a relocalisation."""
        self.max_error, self.contradictions = _CONTRADICTION * self.aligner.usual_error.doubtful, 0

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
        """Whether a keyframe just inserted refutes the relocalisation. If it confirms it, the check ends."""
        first = self.graph.unverified_from
        if first is None:
            return False
        witnesses = [self.graph.keyframes[i] for i in keyframe.covisible_references if i < first][:_WITNESSES]
        compared = [self.aligner.photometric_comparison(keyframe, witness, keyframe.T_wk) for witness in witnesses]
        errors = [error for in_view, error in compared if in_view > TELLING_SHARE]
        if not errors:
            return False
        agrees = min(errors) <= self.max_error
        self.contradictions = 0 if agrees else self.contradictions + 1
        distance = pose_distances(self.graph.keyframes[first].T_wk[None].numpy(), keyframe.T_wk[None].numpy())[0]
        if agrees and distance > _CONFIRMED_AFTER:
            self.graph.confirm()
        if self.contradictions < _CONTRADICTIONS:
            return False
        self.refuted += 1
        return True
