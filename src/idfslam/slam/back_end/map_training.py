"""Updates of the map (Sec. IV): each trains on a view and on replayed keyframes, at once or beside the frames that follow."""

from collections.abc import Sequence

from idfslam.config import Config
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.replay import Replay
from idfslam.mapping.mapper import Mapper
from idfslam.slam.back_end.refinement import Refinement
from idfslam.slam.back_end.relearn_queue import RelearnQueue
from idfslam.slam.back_end.update_interval import UpdateInterval
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Tracked
from idfslam.storage.state import Stateful

# [map updates] around the camera after a loop or a merge, before the next frame; further updates follow by replay. More: the next frames
# are tracked more surely, after a longer pause. Chosen by hand.
_UPDATES_AFTER_MOVE = 10


class MapTraining(Stateful):
    """Trains the map on views and on replayed keyframes, whose poses it refines first."""

    def __init__(
        self,
        config: Config,
        graph: KeyframeGraph,
        frames: FramePoses,
        replay: Replay,
        relearn: RelearnQueue,
        mapper: Mapper,
        refinement: Refinement,
        timer: StageTimer,
    ) -> None:
        self.config, self.graph, self.replay, self.relearn = config, graph, replay, relearn
        self.mapper, self.refinement, self.timer = mapper, refinement, timer
        self.interval = UpdateInterval(config.mapper.every, frames)

    def are_due(self, view: Keyframe, tracked: Tracked) -> bool:
        """Whether the map is to learn the last frame, which is no keyframe."""
        return self.interval.is_due(view, tracked)

    def initialise(self, keyframe: Keyframe) -> dict[str, float]:
        """Trains the map on the first keyframe of a submap. Replay preserves the other submaps."""
        replayed = self._replayed(keyframe) if keyframe.host else []
        with self.timer.stage("map"):
            return self._learn([keyframe, *replayed], self.config.mapper.first_iterations)

    def update(self, view: Keyframe, *, at_once: bool, double_tables: bool = False) -> dict[str, float]:
        """Refines replayed keyframes, then trains the map on them and the view; returns losses by name.

        at_once: the update ends before the next frame. Otherwise it may run in the background, and the losses of the update before it are
        returned.
        """
        self.interval.begin()
        replayed, iterations = self._replayed(view), self.config.mapper.iterations
        with self.timer.stage("refine"):
            self.refinement.refine(replayed[: self.config.refinement.poses_per_update])
        window = [view, *replayed]
        if at_once:
            with self.timer.stage("map"):
                losses = self._learn(window, iterations, double_tables=double_tables)
        else:
            self.relearn.trained(window)
            with self.timer.stage("wait" if self.mapper.updates.in_background else "map"):
                losses = self.mapper.start_update(window, iterations, double_tables=double_tables)
        self.timer.milliseconds["map"] += self.mapper.updates.times()
        return losses

    def follow(self, keyframe: Keyframe) -> None:
        """Trains the map around the newest keyframe before the next frame, after what it sees has moved."""
        with self.timer.stage("map"):
            for _ in range(_UPDATES_AFTER_MOVE):
                self._learn([keyframe, *self._replayed(keyframe)], self.config.mapper.iterations)

    def _replayed(self, view: Keyframe) -> list[Keyframe]:
        """The keyframes that an update trains on besides a view: those that have moved and wait to be learnt again, or random ones."""
        return self.relearn.nearest(view, self.graph.keyframes, self.replay.count) or self.replay.draw(view)

    def _learn(self, window: Sequence[Keyframe], iterations: int, *, double_tables: bool = False) -> dict[str, float]:
        self.relearn.trained(window)
        return self.mapper.optimise_map(window, iterations, double_tables=double_tables)
