"""Keyframes at a fixed interval, as in NICE-SLAM's code."""

from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_selection import KeyframeSelection


class KeyframeInterval(KeyframeSelection):
    """The first frame with depth, and every frame whose index is a multiple of the interval."""

    def _is_needed(self, view: Keyframe, status: Status, in_view: float) -> bool:
        return self.graph.last_keyframe is None or view.index % self.config.interval == 0
