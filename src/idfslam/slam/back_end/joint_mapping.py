"""The back end of iMAP and NICE-SLAM: map and poses of a window are optimised together, at keyframes and every few frames."""

from collections.abc import Callable
from functools import partial

from idfslam.config import Config
from idfslam.graph.coverage import Coverage
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.mapping.joint.joint_map import JointMap
from idfslam.mapping.joint.window_poses import WindowPoses, oldest
from idfslam.mapping.training_view import PosedFrame
from idfslam.slam.back_end.back_end import BackEnd
from idfslam.slam.back_end.mapping_window import MappingWindow
from idfslam.slam.back_end.update_interval import UpdateInterval
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Tracked

_WIDER = 2  # factor on the window of the updates after the last frame (NICE-SLAM's code). More: more keyframes, fewer pixels of each


class JointMapping(BackEnd):
    """Learns each keyframe, and every `mapper.every`-th frame, in a window with stored keyframes."""

    def __init__(
        self,
        config: Config,
        graph: KeyframeGraph,
        frames: FramePoses,
        coverage: Coverage,
        map: JointMap,
        window: MappingWindow,
        timer: StageTimer,
        on_keyframe: Callable[[], None],
    ) -> None:
        """on_keyframe: called once a keyframe was learnt."""
        self.config, self.graph, self.frames, self.coverage = config, graph, frames, coverage
        self.map, self.window, self.timer, self.on_keyframe = map, window, timer, on_keyframe
        self.interval = UpdateInterval(config.mapper.every, frames)

    def add_keyframe(self, keyframe: Keyframe, tracked: Tracked) -> dict[str, float]:
        """Learns the keyframe with a window, and stores it."""
        first = self.graph.last_keyframe is None
        losses = {} if first else self._update(keyframe)
        self.graph.insert(keyframe)
        if first:  # its pose is the world
            losses = self._learn(keyframe, self.config.mapper.first_iterations, first=True)
        self._follow(keyframe)
        self.on_keyframe()
        return losses

    def between_keyframes(self, view: Keyframe, tracked: Tracked) -> dict[str, float]:
        """Learns the frame, if an update is due, without storing it."""
        if self.graph.last_keyframe is None or not self.interval.is_due(view, tracked):
            return {}
        losses = self._update(view)
        self._follow(view)
        return losses

    def finish(self) -> None:
        """Refines what the window around the last keyframe shows, if the map asks for it."""
        with self.timer.stage("finish"):
            for _ in range(self.map.refinement_rounds):
                self._learn(self.graph.keyframes[-1], self.config.mapper.iterations, last=True)

    def _update(self, view: Keyframe) -> dict[str, float]:
        return self._learn(view, self.config.mapper.iterations)

    def _learn(self, view: Keyframe, steps: int, *, first: bool = False, last: bool = False) -> dict[str, float]:
        """Optimises map and poses in windows around a frame, and moves the frames of these."""
        self.interval.begin()
        with self.timer.stage("map"):
            draw = self.window.around(view, wider=_WIDER if last else 1)
            poses = WindowPoses(self.config.joint_mapping.pose_learning_rate, self.map.device, partial(self._may_move, oldest(draw())))
            losses = self.map.optimise(draw, steps, poses, first=first, last=last)
        for frame, T_wk in poses.poses():
            assert isinstance(frame, Keyframe)
            self.graph.set_pose(frame, T_wk)
        return losses

    def _may_move(self, oldest_frame: PosedFrame, frame: PosedFrame) -> bool:
        """Whether a frame's pose is optimised: the world's first frame and the oldest of a window are not."""
        enough = len(self.graph.keyframes) > self.config.joint_mapping.poses_from
        return enough and frame is not oldest_frame and frame is not self.graph.keyframes[0]

    def _follow(self, view: Keyframe) -> None:
        """Takes over the frame's pose, and what it shows."""
        self.frames.attach_last(view)
        self.coverage.add(view)
