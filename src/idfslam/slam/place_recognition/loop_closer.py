"""Loop closing: a new keyframe is compared with places seen before, and drift is corrected.

Here the tracker and the images verify loops. `graph/loop_consistency.py` decides which of the verified loops are consistent. The map learns
moved keyframes again by replay.
"""

from collections.abc import Sequence
from typing import Any

from idfslam.config import LoopConfig
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.loop_consistency import Loop, LoopConsistency
from idfslam.slam.keyframe_hook import RELEARN_SHIFT, KeyframeHook, Moved
from idfslam.slam.place_recognition.relocaliser import Relocaliser
from idfslam.storage.state import State

_OVERLAPPING = 2  # candidates chosen by their pose; the others are chosen by similarity. More: fewer are chosen by similarity. By hand


class LoopCloser(KeyframeHook):
    """Closes loops in a graph."""

    def __init__(self, config: LoopConfig, relocaliser: Relocaliser, graph: KeyframeGraph) -> None:
        self.config, self.relocaliser, self.graph = config, relocaliser, graph
        self.loops = LoopConsistency(config)

    def state(self) -> State:
        """The loops."""
        return {"loops": self.loops.state()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.loops.restore(state["loops"])

    def figures(self) -> dict[str, Any]:
        return self.loops.summary(self.graph)

    def closed_loops(self) -> Sequence[Loop]:
        return self.loops.closed

    def on_split(self) -> None:
        self.loops.forget_between(self.graph)

    def on_keyframe(self, keyframe: Keyframe) -> Moved:
        """Adds edges to covisible keyframes that the images confirm, and closes a loop if there is drift."""
        reachable = self.loops.within_reach(self.graph, keyframe)
        self._verify_covisible(keyframe, reachable)
        for i in self._candidates(keyframe, reachable):
            T_wc = self.relocaliser.verify_loop(keyframe, self.graph.keyframes[i])
            if T_wc is not None:
                return self._offer(Loop.to(keyframe, self.graph, i, T_wc))
        return Moved()

    def _verify_covisible(self, keyframe: Keyframe, reachable: list[int]) -> None:
        """Adds an edge to each covisible keyframe whose image agrees at the present pose. There is no drift then."""
        for i in [i for i in keyframe.unverified if i not in reachable][: self.config.tries]:
            if self.relocaliser.images_agree(keyframe, self.graph.keyframes[i], keyframe.T_wk):
                self.graph.add_edge(keyframe, i)

    def _offer(self, loop: Loop) -> Moved:
        shifts = self.loops.offer(self.graph, loop)
        return Moved([moved for moved, shift in zip(self.graph.keyframes, shifts) if shift > RELEARN_SHIFT], at_once=bool(shifts))

    def _candidates(self, keyframe: Keyframe, reachable: list[int]) -> list[int]:
        """Stored keyframes without an edge that are covisible at their poses, then those with the most similar descriptors."""
        overlapping = [i for i in keyframe.unverified if i in reachable][:_OVERLAPPING]
        keyframes = [self.graph.keyframes[i] for i in reachable]
        similar = [reachable[i] for i in self.relocaliser.retrieve(keyframe, keyframes, self.config.tries)]
        return [*overlapping, *(i for i in similar if i not in overlapping)][: self.config.tries]
