"""Merging submaps: each new keyframe is relocalised in the other submaps, until the relative pose of two submaps is known.

The relative pose of two submaps has no prior, so it cannot expose places that only look alike. Therefore several keyframes along a path,
each convincing and unambiguous, must agree before two submaps are merged.
"""

import logging
from typing import Any

from idfslam.config import LoopConfig
from idfslam.geometry.pose_distance import pose_distances
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.loop_consistency import Loop, same_correction
from idfslam.slam.keyframe_hook import KeyframeHook, Moved
from idfslam.slam.place_recognition.relocaliser import Relocaliser
from idfslam.storage.state import State

log = logging.getLogger(__name__)


class SubmapMerger(KeyframeHook):
    """Merges the submaps of a graph."""

    def __init__(self, config: LoopConfig, relocaliser: Relocaliser, graph: KeyframeGraph, frames: FramePoses) -> None:
        self.config, self.relocaliser, self.graph, self.frames = config, relocaliser, graph, frames
        self.agreeing: list[Loop] = []  # the last consecutive loops to another submap that agree
        self.merged = 0  # number of merges

    def state(self) -> State:
        """The agreeing loops and the number of merges."""
        return {"agreeing": [loop.state() for loop in self.agreeing], "merged": self.merged}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.agreeing, self.merged = [Loop.from_state(loop) for loop in state["agreeing"]], state["merged"]

    def figures(self) -> dict[str, Any]:
        return {"submaps_merged": self.merged}

    def on_split(self) -> None:
        self.agreeing = []  # they belong to poses that were wrong

    def on_keyframe(self, keyframe: Keyframe) -> Moved:
        loop = self._sighting(keyframe)
        if loop is None:
            return Moved()
        agrees = bool(self.agreeing) and same_correction(self.graph, self.agreeing[-1], loop, self.config.confirmed_within)
        self.agreeing = [*self.agreeing, loop] if agrees else [loop]
        if len(self.agreeing) < self.config.merge_confirmations or self._span() < self.config.merge_span:
            return Moved()
        return self._merge(loop)

    def _merge(self, loop: Loop) -> Moved:
        self.agreeing = []
        self.merged += 1
        a, b = (self.graph.keyframes[i].index for i in (loop.a, loop.b))
        shifts = self.graph.merge_submaps(loop.a, loop.b, loop.T_ab)
        log.info("submaps merged: frame %d was seen again at frame %d", a, b)
        log.info("%d frames between the submaps are interpolated", self.frames.interpolate_gaps())
        return Moved([moved for moved, shift in zip(self.graph.keyframes, shifts) if shift > 0], submap=True)

    def _span(self) -> float:
        """The distance [m] between the first and the last of the agreeing loops, in shift and turn."""
        first, last = (self.graph.keyframes[loop.b].T_wk[None].numpy() for loop in (self.agreeing[0], self.agreeing[-1]))
        return float(pose_distances(first, last)[0])

    def _sighting(self, keyframe: Keyframe) -> Loop | None:
        """The loop from a keyframe of another submap to this keyframe, if it is relocalised there."""
        others = [other for other in self.graph.keyframes if other.submap != keyframe.submap]
        result = self.relocaliser.relocalise(keyframe, others, self.config.relocalisation_tries)
        if result is None:
            return None
        other, aligned = result
        return Loop.to(keyframe, self.graph, other.host, aligned.T_wc)
