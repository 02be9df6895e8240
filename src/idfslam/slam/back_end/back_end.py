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
from idfslam.slam.back_end.finetuner import Finetuning
from idfslam.slam.back_end.keyframe_pose import KeyframePose
from idfslam.slam.back_end.map_training import MapTraining
from idfslam.slam.back_end.polish import Polishing
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.slam.keyframe_hook import KeyframeHook
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Tracked
from idfslam.storage.state import Stateful

# [map updates] If the last keyframe is at most so far back, the camera runs ahead of the map, and the next frame waits for the update.
# More: more frames wait. Chosen by hand.
_CLOSE_KEYFRAMES = 2


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
        features: KeyframeFeatures,
        keyframe_pose: KeyframePose,
        hooks: Sequence[KeyframeHook],
        updates: MapTraining,
        polish: Polishing,
        finetuner: Finetuning,
        timer: StageTimer,
    ) -> None:
        self.config, self.graph, self.frames, self.coverage, self.features = config, graph, frames, coverage, features
        self.keyframe_pose, self.hooks, self.updates = keyframe_pose, list(hooks), updates
        self.polish, self.finetuner, self.timer = polish, finetuner, timer

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
        self.features.extract_beside(keyframe)
        self._run_hooks(keyframe)
        self.coverage.add(keyframe)
        if last is None:
            return self.updates.initialise(keyframe)
        camera_ahead_of_map = keyframe.index - last.index <= _CLOSE_KEYFRAMES * self.config.mapper.every
        unmapped = tracked.evidence.mapped_share < self.config.mapper.min_mapped_share
        return losses | self.updates.update(keyframe, at_once=camera_ahead_of_map or unmapped, double_tables=stored)

    def between_keyframes(self, view: Keyframe, tracked: Tracked) -> dict[str, float]:
        """Updates the map on the frame if an update is due and its pose is trusted, and otherwise finetunes the tracker (Sec. V-B)."""
        if not self.updates.are_due(view, tracked):
            return self.finetuner.step()
        self.graph.connect_like_last(view)
        self.coverage.add(view)
        return self.updates.update(view, at_once=False)

    def learn_again(self, keyframe: Keyframe) -> None:
        self.updates.initialise(keyframe)

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
        """Calls the hooks until one moves a whole submap. The map is to learn again what they move."""
        for hook in self.hooks:
            with self.timer.stage("loops"):
                moved = hook.on_keyframe(keyframe)
            self.updates.relearn.add(moved.keyframes)
            self.coverage.follow(moved.keyframes)
            if moved.split:
                for other in self.hooks:
                    other.on_split()
            if moved.submap or moved.at_once:
                self.updates.follow(keyframe)
            if moved.submap:
                return
