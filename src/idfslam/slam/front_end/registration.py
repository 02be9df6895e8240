"""Registration: the paper's front end, the neural tracker against the last keyframe (Sec. V)."""

from torch import Tensor

from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.front_end.front_end import FrontEnd
from idfslam.slam.front_end.pair_registration import PairRegistration
from idfslam.slam.front_end.registered_pose import RegisteredPose
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Source, Tracked
from idfslam.tracking.tracker import Tracker


class Registration(FrontEnd):
    """The neural tracker against the last keyframe (Sec. V)."""

    def __init__(self, tracker: Tracker, features: KeyframeFeatures, graph: KeyframeGraph, timer: StageTimer) -> None:
        self.tracker, self.pairs, self.graph, self.timer = tracker, PairRegistration(tracker, features), graph, timer

    def track(self, view: Keyframe) -> Tracked:
        pose = self.register(view)
        if pose is None:
            return Tracked(view.T_wk, Status.LOST, Source.PREDICTED)
        return Tracked(pose.T_wc, Status.OK, Source.REGISTERED, covariance=pose.covariance)

    def register(self, view: Keyframe, near: Tensor | None = None) -> RegisteredPose | None:
        """The pose of a view by the first keyframe that it can be registered with. near: a pose (4, 4) that it probably has."""
        with self.timer.stage("track"):
            for reference in self.graph.tracking_references(view):
                if (found := self.pairs.register(view, reference, near)) is not None:
                    return found
        return None
