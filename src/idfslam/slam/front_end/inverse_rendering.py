"""The front end of iMAP and NICE-SLAM: every frame's pose is optimised until the rendered map shows the frame."""

from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.mapping.joint.joint_map import JointMap
from idfslam.slam.front_end.front_end import FrontEnd
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Source, Tracked


class InverseRendering(FrontEnd):
    """Adam on the pose against the frozen map (iMAP, Sec. 3.3; NICE-SLAM, Sec. 3.4). Only a frame without depth is lost."""

    def __init__(self, map: JointMap, timer: StageTimer) -> None:
        self.map, self.timer = map, timer

    def track(self, view: Keyframe) -> Tracked:
        if not view.has_depth:
            return Tracked(view.T_wk, Status.LOST, Source.PREDICTED)
        with self.timer.stage("track"):
            T_wc, _ = self.map.track(view)
        return Tracked(T_wc, Status.OK, Source.ALIGNED)
