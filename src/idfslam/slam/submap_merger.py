"""Joining pieces: a new keyframe is looked for in the pieces of the graph that it does not belong to, until where they lie is known.

Nothing limits how far two pieces may be apart, and places that look alike are told from each other by what lies around them. So several
keyframes over some way, each convincing and with no other place that serves as well, must say the same before two pieces become one.
"""

import logging

from idfslam.config import LoopConfig
from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.loop_consistency import Loop, loop_from, plain_loop, same_correction
from idfslam.graph.path_length import distances
from idfslam.slam.relocaliser import Localiser
from idfslam.storage.state import State

log = logging.getLogger(__name__)


class PieceJoiner:
    """Joins pieces of a graph, and counts how many it has joined."""

    def __init__(self, config: LoopConfig, localiser: Localiser, graph: KeyframeGraph) -> None:
        self.config, self.localiser, self.graph = config, localiser, graph
        self.agreeing: list[Loop] = []  # the last findings, as far as they say the same
        self.joined = 0

    def state(self) -> State:
        """The findings and the count."""
        return {"agreeing": [plain_loop(loop) for loop in self.agreeing], "joined": self.joined}

    def restore(self, state: State) -> None:
        """What `state` told."""
        self.agreeing, self.joined = [loop_from(loop) for loop in state["agreeing"]], state["joined"]

    def join(self, keyframe: Keyframe) -> bool:
        """Whether a chosen keyframe has just joined its piece to another; the younger one has moved, and the map is to learn it anew."""
        loop = self._found_elsewhere(keyframe)
        if loop is None:
            return False
        same = bool(self.agreeing) and same_correction(self.graph, self.agreeing[-1], loop, self.config.confirmed_within)
        self.agreeing = [*self.agreeing, loop] if same else [loop]
        if len(self.agreeing) < self.config.merge_confirmations or self._span() < self.config.merge_span:
            return False
        self.agreeing = []
        self.joined += 1
        a, b = (self.graph.keyframes[i].index for i in (loop.a, loop.b))
        for moved, distance in zip(self.graph.keyframes, self.graph.join(loop.a, loop.b, loop.T_ab)):
            if distance > 0:
                moved.unlearnt = self.config.relearn_updates
        log.info("pieces joined: frame %d was seen again at frame %d", a, b)
        return True

    def _span(self) -> float:
        """How far [m] the camera has come, or what it looks at, since the first of the agreeing findings."""
        first, last = (self.graph.keyframes[loop.b].T_wk[None].numpy() for loop in (self.agreeing[0], self.agreeing[-1]))
        return float(distances(first, last)[0])

    def _found_elsewhere(self, keyframe: Keyframe) -> Loop | None:
        """The keyframe of another piece that this one sees again, and how they lie."""
        others = [other for other in self.graph.keyframes if other.piece != keyframe.piece]
        found = self.localiser.locate_among(keyframe, others, self.config.relocalisation_tries, self.graph)
        if found is None:
            return None
        other, aligned = found
        T_wb = self.graph.keyframes[keyframe.anchor].T_wk
        T_ab = se3.inverse(other.T_wk) @ aligned.T_wc @ se3.inverse(keyframe.T_wk) @ T_wb
        return Loop(other.anchor, keyframe.anchor, T_ab, keyframe.index)
