"""The back end: it inserts keyframes into graph and map (Sec. IV), and updates the map between keyframes."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from idfslam.config import Config
from idfslam.graph.coverage import Coverage
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.loop_consistency import Loop
from idfslam.graph.replay import Replay
from idfslam.mapping.mapper import Mapper
from idfslam.slam.finetuner import Finetuning
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.slam.keyframe_hook import KeyframeHook
from idfslam.slam.keyframe_pose import KeyframePose
from idfslam.slam.polish import Polishing
from idfslam.slam.refinement import Refinement
from idfslam.slam.relearn_queue import RelearnQueue
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Tracked
from idfslam.slam.update_interval import UpdateInterval
from idfslam.storage.state import Stateful

# [map updates] If the last keyframe is at most so far back, the camera runs ahead of the map, and the next frame waits for the update.
# More: more frames wait. Chosen by hand.
_CLOSE_KEYFRAMES = 2
# [map updates] around the camera after a loop or a merge, before the next frame; further updates follow by replay. More: the next frames
# are tracked more surely, after a longer pause. Chosen by hand.
_UPDATES_AFTER_MOVE = 10


class BackEnd(Stateful, ABC):
    """Maps frames. Another back end must implement `add_keyframe` only."""

    @abstractmethod
    def add_keyframe(self, keyframe: Keyframe, tracked: Tracked) -> dict[str, float]:
        """Adds the last frame, which was selected as a keyframe; returns losses by name."""

    def between_keyframes(self, view: Keyframe, tracked: Tracked) -> dict[str, float]:
        """Called after a frame that is no keyframe; returns losses by name."""
        return {}

    def learn_again(self, keyframe: Keyframe) -> None:
        """Called when the images of the first keyframe were replaced, before another one is added."""

    def finish(self) -> None:
        """Called after the last frame. Something may go on beside what follows, which does not change it."""

    def settle(self) -> None:
        """Waits for what `finish` has left running."""

    def loops(self) -> Sequence[Loop]:
        """The loops that were closed."""
        return ()

    def figures(self) -> dict[str, Any]:
        """Counts for metrics.json."""
        return {}


class KeyframeMapping(BackEnd):
    """A neural map that learns from each keyframe and from replayed ones."""

    def __init__(
        self,
        config: Config,
        graph: KeyframeGraph,
        frames: FramePoses,
        coverage: Coverage,
        replay: Replay,
        relearn: RelearnQueue,
        mapper: Mapper,
        features: KeyframeFeatures,
        keyframe_pose: KeyframePose,
        hooks: Sequence[KeyframeHook],
        refinement: Refinement,
        polish: Polishing,
        finetuner: Finetuning,
        timer: StageTimer,
    ) -> None:
        self.config, self.graph, self.frames, self.coverage, self.replay, self.relearn = config, graph, frames, coverage, replay, relearn
        self.mapper, self.features, self.keyframe_pose, self.hooks = mapper, features, keyframe_pose, list(hooks)
        self.refinement, self.polish, self.finetuner, self.timer = refinement, polish, finetuner, timer
        self.interval = UpdateInterval(config.mapper.every, frames)

    def loops(self) -> Sequence[Loop]:
        return [loop for hook in self.hooks for loop in hook.closed_loops()]

    def figures(self) -> dict[str, Any]:
        hooks = {name: value for hook in self.hooks for name, value in hook.figures().items()}
        return hooks | self.finetuner.figures()

    def add_keyframe(self, keyframe: Keyframe, tracked: Tracked) -> dict[str, float]:
        """Refines the keyframe's pose, inserts it into the graph, and trains the map on it and on replayed ones (Sec. IV)."""
        last = self.graph.last_keyframe
        losses = {} if last is None else self.keyframe_pose.refine(keyframe, tracked)
        stored = self.graph.insert(keyframe)
        self.frames.attach_last(keyframe)
        self.features.of(keyframe)
        self._run_hooks(keyframe)
        self.coverage.add(keyframe)
        if last is None:
            return self._initialise(keyframe)
        camera_ahead_of_map = keyframe.index - last.index <= _CLOSE_KEYFRAMES * self.config.mapper.every
        unmapped = tracked.evidence.mapped_share < self.config.mapper.min_mapped_share
        return losses | self._update_map(keyframe, at_once=camera_ahead_of_map or unmapped, double_tables=stored)

    def between_keyframes(self, view: Keyframe, tracked: Tracked) -> dict[str, float]:
        """Updates the map on the frame if an update is due and its pose is trusted, and otherwise finetunes the tracker (Sec. V-B)."""
        if not self.interval.is_due(view, tracked):
            return self.finetuner.step()
        self.graph.connect_like_last(view)
        self.coverage.add(view)
        return self._update_map(view, at_once=False)

    def learn_again(self, keyframe: Keyframe) -> None:
        self._initialise(keyframe)

    def finish(self) -> None:
        with self.timer.stage("finish"):
            self.polish.run()
            for hook in self.hooks:
                hook.on_finish()

    def settle(self) -> None:
        with self.timer.stage("finish"):
            for hook in self.hooks:
                hook.settle()

    def _run_hooks(self, keyframe: Keyframe) -> None:
        """Relocalisation check, loops, merged submaps: the map is to learn again what they move."""
        for hook in self.hooks:
            with self.timer.stage("loops"):
                moved = hook.on_keyframe(keyframe)
            self.relearn.add(moved.keyframes)
            self.coverage.follow(moved.keyframes)
            if moved.split:
                for other in self.hooks:
                    other.on_split()
            if moved.submap or moved.at_once:
                self._follow(keyframe)
            if moved.submap:
                return

    def _follow(self, keyframe: Keyframe) -> None:
        """Trains the map around the newest keyframe before the next frame, after what it sees has moved."""
        with self.timer.stage("map"):
            for _ in range(_UPDATES_AFTER_MOVE):
                self._learn([keyframe, *self._replayed(keyframe)], self.config.mapper.iterations)

    def _initialise(self, keyframe: Keyframe) -> dict[str, float]:
        """Trains the map on the first keyframe of a submap. Replay preserves the other submaps."""
        replayed = self._replayed(keyframe) if keyframe.host else []
        with self.timer.stage("map"):
            return self._learn([keyframe, *replayed], self.config.mapper.first_iterations)

    def _update_map(self, view: Keyframe, *, at_once: bool, double_tables: bool = False) -> dict[str, float]:
        """Refines replayed keyframes, then trains the map on them and the view.

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

    def _replayed(self, view: Keyframe) -> list[Keyframe]:
        """The keyframes that an update trains on besides a view: those that have moved and wait to be learnt again, or random ones."""
        return self.relearn.nearest(view, self.graph.keyframes, self.replay.count) or self.replay.draw(view)

    def _learn(self, window: Sequence[Keyframe], iterations: int, *, double_tables: bool = False) -> dict[str, float]:
        self.relearn.trained(window)
        return self.mapper.optimise_map(window, iterations, double_tables=double_tables)
