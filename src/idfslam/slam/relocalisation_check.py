"""The trial of a place that a lost camera was found at by its looks: two places can look alike for metres, but not for ever.

What is mapped from there on stays apart from what was known until the camera has gone some way and still sees what it should. Where the
images of old keyframes contradict it instead, it was another place, and becomes a piece of its own (graph/pieces.py).
"""

from idfslam.alignment.aligner import Aligner
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.path_length import distances
from idfslam.storage.state import State

_WAY = 3.0  # [m], or turned as much 2 m ahead: from there on one keyframe that agrees is enough
_WITNESSES = 4  # old keyframes that a new one is compared with
_IN_VIEW = 0.3  # smaller share of an old keyframe's landmarks in view: it says nothing
_CONTRADICTS = 1.4  # times the difference of brightness that is doubtful
_TWICE = 2  # keyframes in a row that all witnesses contradict


class Trial:
    """Judges the keyframes of a graph that came after `graph.trial`."""

    def __init__(self, aligner: Aligner, graph: KeyframeGraph) -> None:
        self.aligner, self.graph = aligner, graph
        self.limit = 0.0  # differences of brightness above it contradict
        self.against = 0  # keyframes in a row that were contradicted
        self.refuted = 0  # places that were given up

    def state(self) -> State:
        """Where it stands."""
        return {"limit": self.limit, "against": self.against, "refuted": self.refuted}

    def restore(self, state: State) -> None:
        """What `state` told."""
        self.limit, self.against, self.refuted = state["limit"], state["against"], state["refuted"]

    def begin(self) -> None:
        """A place was found just now."""
        self.limit, self.against = _CONTRADICTS * self.aligner.doubtful_brightness, 0

    def refutes(self, keyframe: Keyframe) -> bool:
        """Whether a keyframe just chosen shows that the place was another one; where it shows that it was right, the trial ends."""
        first = self.graph.trial
        if first is None:
            return False
        witnesses = [self.graph.keyframes[i] for i in keyframe.alike if i < first][:_WITNESSES]
        heard = [self.aligner.compare(keyframe, witness, keyframe.T_wk) for witness in witnesses]
        differences = [difference for in_view, difference in heard if in_view > _IN_VIEW]
        if not differences:
            return False
        agrees = min(differences) <= self.limit
        self.against = 0 if agrees else self.against + 1
        way = distances(self.graph.keyframes[first].T_wk[None].numpy(), keyframe.T_wk[None].numpy())[0]
        if agrees and way > _WAY:
            self.graph.trial = None
        if self.against < _TWICE:
            return False
        self.refuted += 1
        return True
