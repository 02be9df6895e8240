"""Keyframes by information gain (iMAP, Sec. 3.4): a frame that the map, as it was at the last keyframe, explains too little of."""

from collections.abc import Callable

from idfslam.config import KeyframeConfig
from idfslam.frame import Status
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.keyframe_selection import KeyframeSelection


class InformationGain(KeyframeSelection):
    """Asks the map which share of a frame it explains."""

    def __init__(
        self, config: KeyframeConfig, graph: KeyframeGraph, frames: FramePoses, explained: Callable[[Keyframe], float], *, lost_frames: bool
    ) -> None:
        """explained: share of a frame's readings that the map at the last keyframe explains."""
        super().__init__(config, graph, frames, lost_frames=lost_frames)
        self._explained = explained

    def _is_needed(self, view: Keyframe, status: Status, in_view: float) -> bool:
        return self.graph.last_keyframe is None or self._explained(view) < self.config.explained
