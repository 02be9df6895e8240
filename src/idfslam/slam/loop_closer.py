"""Loop closing: a new keyframe is compared with places seen before, and drift is undone.

`graph/loops.py` says what may be believed; here the tracker and the images are asked. The map follows by what is replayed next.
"""

from idfslam.config import LoopConfig
from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.loop_consistency import Loop, Loops
from idfslam.slam.relocaliser import Localiser
from idfslam.storage.state import State

_MOVED = 0.005  # [m] a keyframe must be moved by a loop for the map to learn it anew
_OVERLAPPING = 2  # of the keyframes compared, those that should see the same by their pose; the others are those that look most alike


class LoopCloser:
    """Closes loops in a graph, and says which keyframes the map has yet to follow."""

    def __init__(self, config: LoopConfig, localiser: Localiser, graph: KeyframeGraph) -> None:
        self.config, self.localiser, self.graph = config, localiser, graph
        self.loops = Loops(config)

    def state(self) -> State:
        """The loops."""
        return {"loops": self.loops.state()}

    def restore(self, state: State) -> None:
        """What `state` told."""
        self.loops.restore(state["loops"])

    def close(self, keyframe: Keyframe) -> None:
        """Has a chosen keyframe's place been seen before, from a pose that it was not measured against? Then drift is undone."""
        apart = self.loops.within_reach(self.graph, keyframe)
        for i in [i for i in keyframe.unlinked if i not in apart][: self.config.tries]:
            if self.localiser.agrees(keyframe, self.graph.keyframes[i], keyframe.T_wk):  # no drift: the pose is right already
                self.graph.link(keyframe, i)
        for i in self._candidates(keyframe, apart):
            other = self.graph.keyframes[i]
            T_wc = self.localiser.seen_again(keyframe, other, self.graph.beside(other, self.localiser.references))
            if T_wc is not None:
                T_wb = self.graph.keyframes[keyframe.anchor].T_wk
                T_ab = se3.inverse(other.T_wk) @ T_wc @ se3.inverse(keyframe.T_wk) @ T_wb
                changes = self.loops.offer(self.graph, Loop(i, keyframe.anchor, T_ab, keyframe.index))
                for moved, change in zip(self.graph.keyframes, changes):
                    if change > _MOVED:
                        moved.unlearnt = self.config.relearn_updates
                break

    def _candidates(self, keyframe: Keyframe, apart: list[int]) -> list[int]:
        """Of stored keyframes that are not linked with this one, those that should see the same by their pose, or that look alike."""
        overlapping = [i for i in keyframe.unlinked if i in apart][:_OVERLAPPING]
        alike = [apart[i] for i in self.localiser.most_alike(keyframe, [self.graph.keyframes[i] for i in apart], self.config.tries)]
        return [*overlapping, *(i for i in alike if i not in overlapping)][: self.config.tries]
