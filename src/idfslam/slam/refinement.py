"""Refinement: stored keyframes are aligned anew to the map as it has become, in turns with the map, which then learns from all of them.

It alternates and is not a joint bundle adjustment: one keyframe moves at a time, and the map stands still meanwhile.
"""

from collections.abc import Sequence

from idfslam.alignment.aligner import Aligner
from idfslam.alignment.motion import change_between, moved
from idfslam.config import RefinementConfig
from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.relearn_queue import RelearnQueue


class NoRefinement:
    """Keyframes stay where they were mapped, as in the paper."""

    def refine(self, keyframes: Sequence[Keyframe]) -> None:
        """Moves keyframes of the graph."""


class KeyframeRefinement(NoRefinement):
    """Aligns keyframes to the map and to the images of older keyframes."""

    def __init__(self, config: RefinementConfig, graph: KeyframeGraph, relearn: RelearnQueue, aligner: Aligner) -> None:
        self.config, self.graph, self.relearn, self.aligner = config, graph, relearn, aligner

    def refine(self, keyframes: Sequence[Keyframe]) -> None:
        """Leaves out the first keyframe of each submap, which defines its world, and those that wait to be learnt where a loop has moved
        them: the map would draw them back.
        """
        for keyframe in keyframes:
            if keyframe.host != keyframe.submap and keyframe not in self.relearn:
                self._refine(keyframe)

    def _refine(self, keyframe: Keyframe) -> None:
        references = self.graph.older_references(keyframe, self.aligner.config.references)
        aligned = self.aligner.align(keyframe, keyframe.T_wk, references, within=0.0)
        change = change_between(keyframe.T_wk, aligned.T_wc)
        small = float(change[:3].norm()) < self.config.max_shift
        if aligned.status is Status.OK and small and not self.aligner.doubtful(aligned):
            # half way: the map has learnt this place from the present pose, in part
            self.graph.set_pose(keyframe, moved(keyframe.T_wk, change / 2))
        self.aligner.release(keyframe)
