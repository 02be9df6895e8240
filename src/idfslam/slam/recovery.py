"""Recovery: a lost camera is looked for among all keyframes; where it stays lost, mapping goes on in a new submap (not in the paper)."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from enum import Enum

from idfslam.config import LoopConfig
from idfslam.frame import Status
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.relocalisation_check import RelocalisationCheck
from idfslam.slam.relocaliser import Relocaliser
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Source, Tracked
from idfslam.storage.state import State, Stateful

log = logging.getLogger(__name__)

_EXAMPLES = 16  # keyframes from which the usual photometric error is estimated; more: a surer estimate, at a comparison of images each


class Mode(Enum):
    """What the system is doing."""

    STARTING = "starting"  # no frame has a pose yet, and no map is there to be found in
    TRACKING = "tracking"  # the last frame has a pose
    LOST = "lost"  # the last frame has none; at the start, the camera is to be found in a saved map


class Recovery(Stateful, ABC):
    """Confirms what a front end found, or looks for the camera."""

    def __init__(self, graph: KeyframeGraph, frames: FramePoses) -> None:
        self.graph, self.frames = graph, frames

    @property
    def mode(self) -> Mode:
        """What the system is doing before the next frame."""
        if len(self.frames):
            return Mode.LOST if self.frames.last_status is Status.LOST else Mode.TRACKING
        return Mode.LOST if self.graph.keyframes else Mode.STARTING

    @abstractmethod
    def recover(self, view: Keyframe, tracked: Tracked) -> Tracked:
        """What stands for a view at its predicted pose, given what the front end found."""

    def close_gap(self, index: int, mode: Mode) -> None:
        """After the frame `index` was added: gives lost frames before it poses where the camera was found again. mode: before it."""

    def start_in_map(self, keyframes: Sequence[Keyframe]) -> None:
        """Before the first frame of a run that starts in a saved map, of which these are some keyframes."""

    def figures(self) -> dict[str, int]:
        """Counts for metrics.json."""
        return {"relocalisations": 0}


class NoRecovery(Recovery):
    """A lost frame stays where the last motion leads, and is mapped there (Sec. III)."""

    def recover(self, view: Keyframe, tracked: Tracked) -> Tracked:
        return tracked


class Relocalisation(Recovery):
    """Looks for a lost camera among all keyframes, and begins a new submap where it is not found for long."""

    def __init__(
        self,
        config: LoopConfig,
        relocaliser: Relocaliser,
        check: RelocalisationCheck,
        graph: KeyframeGraph,
        frames: FramePoses,
        timer: StageTimer,
    ) -> None:
        super().__init__(graph, frames)
        self.config, self.relocaliser, self.check, self.timer = config, relocaliser, check, timer
        self.relocalisations = 0
        self._searched = 0  # frames with depth in which the camera was looked for since it was lost

    def state(self) -> State:
        """The counts."""
        return {"relocalisations": self.relocalisations, "searched": self._searched}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.relocalisations, self._searched = state["relocalisations"], state["searched"]

    def figures(self) -> dict[str, int]:
        return {"relocalisations": self.relocalisations}

    def start_in_map(self, keyframes: Sequence[Keyframe]) -> None:
        self.relocaliser.estimate_usual_error(keyframes)

    def recover(self, view: Keyframe, tracked: Tracked) -> Tracked:
        if not self._trusts(tracked):
            lost = tracked if self.mode is Mode.TRACKING else tracked.lost(view.T_wk)
            tracked = self._relocalised(view) or lost
        self._searched = self._searched + view.has_depth if tracked.is_lost else 0
        return self._new_submap(view, tracked) if 0 < self.config.submap_after <= self._searched else tracked

    def close_gap(self, index: int, mode: Mode) -> None:
        found_again = mode is Mode.LOST and self.mode is Mode.TRACKING
        if found_again and not self.graph.starts_submap:
            log.info("found again at frame %d; %d frames before it are interpolated", index, self.frames.interpolate_gaps())

    def _trusts(self, tracked: Tracked) -> bool:
        """Whether the front end's answer stands; where the camera was lost, only a convincing alignment to the map does."""
        if self.mode is Mode.TRACKING:
            return not tracked.is_lost and tracked.confident
        return tracked.alignment is not None and self.relocaliser.convincing(tracked.alignment)

    def _relocalised(self, view: Keyframe) -> Tracked | None:
        """The view's pose by the keyframes that look most like it; None if none is convincing."""
        if not view.has_depth:
            return None
        with self.timer.stage("relocalise"):
            if not self.relocaliser.aligner.has_usual_error:  # the front end does not align frames
                self.relocaliser.estimate_usual_error(self.graph.keyframes[-_EXAMPLES:])
            candidate = self.relocaliser.relocalise(view, self.graph.keyframes, self.config.relocalisation_tries)
        if candidate is None:
            return None
        keyframe, alignment = candidate
        self.graph.attach(view, keyframe)
        self.check.begin()
        self.relocalisations += 1
        return Tracked.aligned(alignment, Source.RELOCALISED)

    def _new_submap(self, view: Keyframe, tracked: Tracked) -> Tracked:
        T_wc = self.graph.start_submap()
        log.info("not found for %d frames: mapping goes on in a new submap from frame %d on", self._searched, view.index)
        return replace(tracked, T_wc=T_wc, status=Status.OK, source=Source.NEW_SUBMAP)
