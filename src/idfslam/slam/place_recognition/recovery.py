"""Recovery (not in the paper): a lost camera is relocalised among all keyframes. If that fails for long, a new submap is started."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from enum import Enum

from idfslam.alignment.alignment import TELLING_SHARE, Alignment
from idfslam.config import LoopConfig
from idfslam.frame import Status
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.place_recognition.relocalisation_check import RelocalisationCheck
from idfslam.slam.place_recognition.relocaliser import Relocaliser
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Source, Tracked
from idfslam.slam.world_origin import may_define_world
from idfslam.storage.state import State, Stateful

log = logging.getLogger(__name__)

_DOUBTED = 15  # doubtful frames in a row from which the camera is looked for elsewhere. More: wrong places are left later. Chosen by hand
# [m] from where the camera was lost: it is looked for there first, less than the distance of doors that look alike. More: it is found where
# it walked on fast, and look-alike places pass more easily. This and the next: chosen by hand
_NEARBY = 1.5
_STILL_NEAR = 15  # [frames with depth] for which that holds. More: likewise
# Keyframes, all of little depth, up to which a map does not wait for a camera that it cannot find. More: a longer start under a covered
# lens is left at once, and so is an object without a background. Covered lenses left 1 to 3. Chosen by hand
_MEAGRE = 4
EXAMPLES = 16  # keyframes from which the usual photometric error is estimated. More: a surer estimate, at a comparison of images each


class Mode(Enum):
    """The state of tracking before a frame."""

    STARTING = "starting"  # there is no frame and no map yet
    TRACKING = "tracking"  # the last frame was tracked
    LOST = "lost"  # the last frame was lost; or there is no frame yet, and the camera must be relocalised in a saved map


class Recovery(Stateful, ABC):
    """Confirms the result of a front end, or relocalises the camera."""

    def __init__(self, graph: KeyframeGraph, frames: FramePoses) -> None:
        self.graph, self.frames = graph, frames

    @property
    def mode(self) -> Mode:
        """The state of tracking before the next frame."""
        if len(self.frames):
            return Mode.LOST if self.frames.last_status is Status.LOST else Mode.TRACKING
        return Mode.LOST if self.graph.keyframes else Mode.STARTING

    @abstractmethod
    def recover(self, view: Keyframe, tracked: Tracked) -> Tracked:
        """The final result for a view, given the front end's. The view has its predicted pose."""

    def close_gap(self, index: int, mode: Mode) -> None:
        """Interpolates the lost frames before the frame `index`, just added, if the camera was lost before it and is not lost now.

        mode: the state of tracking before the frame.
        """

    def start_in_map(self, keyframes: Sequence[Keyframe]) -> None:
        """Before the first frame of a run that starts in a saved map, of which these are some keyframes."""

    def figures(self) -> dict[str, int]:
        """Counts for metrics.json."""
        return {"relocalisations": 0}


class NoRecovery(Recovery):
    """No recovery: a lost frame keeps its predicted pose, and is mapped there (Sec. III)."""

    def recover(self, view: Keyframe, tracked: Tracked) -> Tracked:
        return tracked


class Relocalisation(Recovery):
    """Relocalises a lost camera among all keyframes, and starts a new submap if that fails for long."""

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
        self._searched = 0  # number of frames with depth since the camera was lost, or is astray
        self._doubted = 0  # number of doubtful frames in a row

    def state(self) -> State:
        """The counts."""
        return {"relocalisations": self.relocalisations, "searched": self._searched, "doubted": self._doubted}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.relocalisations, self._searched, self._doubted = state["relocalisations"], state["searched"], state["doubted"]

    def figures(self) -> dict[str, int]:
        return {"relocalisations": self.relocalisations}

    def start_in_map(self, keyframes: Sequence[Keyframe]) -> None:
        self.relocaliser.estimate_usual_error(keyframes)

    def recover(self, view: Keyframe, tracked: Tracked) -> Tracked:
        self._doubted = self._doubted + 1 if tracked.status is Status.DOUBTFUL else 0
        if not self._trusts(tracked):
            lost = tracked if self.mode is Mode.TRACKING else tracked.lost(view.T_wk)
            tracked = self._relocalised(view) or lost
        self._searched = self._searched + view.has_depth if tracked.is_lost or self._is_astray(tracked) else 0
        begins = self._searched >= self.config.submap_after or self._begins_anew(view, tracked)
        return self._new_submap(view, tracked) if self.config.submap_after and begins else tracked

    def close_gap(self, index: int, mode: Mode) -> None:
        found_again = mode is Mode.LOST and self.mode is Mode.TRACKING
        if found_again and not self.graph.starts_submap:
            log.info("found again at frame %d; %d frames before it are interpolated", index, self.frames.interpolate_gaps())

    def _trusts(self, tracked: Tracked) -> bool:
        """Whether the front end's result is accepted. After a lost frame only a convincing alignment to the map is.

        A camera that has been in doubt for long is looked for too. If it is not found, the front end's result stands.
        """
        if self.mode is Mode.TRACKING:
            return not tracked.is_lost and tracked.confident and self._doubted < _DOUBTED
        return tracked.alignment is not None and self.relocaliser.convincing(tracked.alignment)

    def _is_astray(self, tracked: Tracked) -> bool:
        """Whether the camera has been in doubt for long, where no keyframe tells whether its pose is right."""
        return self._doubted >= _DOUBTED and tracked.status is Status.DOUBTFUL and tracked.evidence.in_view < TELLING_SHARE

    def _begins_anew(self, view: Keyframe, tracked: Tracked) -> bool:
        """Whether a submap begins with a view at once: it has the depth that no keyframe has, and these do not tell where it is.

        So it is where a recording begins under a covered lens, or in a hall beyond the sensor's reach.
        """
        untold = tracked.is_lost or (self._doubted >= _DOUBTED and tracked.status is Status.DOUBTFUL)
        if not untold or len(self.graph.keyframes) > _MEAGRE or not may_define_world(view):
            return False
        return not any(may_define_world(keyframe) for keyframe in self.graph.keyframes)

    def _relocalised(self, view: Keyframe) -> Tracked | None:
        """Relocalises a view among the keyframes with the most similar descriptors; None if no pose is convincing."""
        if not view.has_depth:
            return None
        with self.timer.stage("relocalise"):
            if not self.relocaliser.aligner.usual_error.is_known:  # the front end does not align frames
                self.relocaliser.estimate_usual_error(self.graph.keyframes[-EXAMPLES:])
            candidate = self._found(view, self._nearby(view)) or self._found(view, self.graph.keyframes)
        if candidate is None:
            return None
        keyframe, alignment = candidate
        self.graph.attach(view, keyframe)
        self.check.begin()
        self.relocalisations += 1
        return Tracked.aligned(alignment, Source.RELOCALISED)

    def _found(self, view: Keyframe, keyframes: Sequence[Keyframe]) -> tuple[Keyframe, Alignment] | None:
        return self.relocaliser.relocalise(view, keyframes, self.config.relocalisation_tries)

    def _nearby(self, view: Keyframe) -> list[Keyframe]:
        """The keyframes around where the camera was lost. Mostly it is still there, and places that look alike are elsewhere.

        Empty where nobody knows: before the first frame of a run in a saved map, after long doubt, and when it was lost for long.
        """
        if not len(self.frames) or self._doubted >= _DOUBTED or self._searched >= _STILL_NEAR:
            return []
        return [k for k in self.graph.keyframes if float((k.T_wk - view.T_wk)[:3, 3].norm()) < _NEARBY]

    def _new_submap(self, view: Keyframe, tracked: Tracked) -> Tracked:
        T_wc = self.graph.start_submap()
        log.info("not found for %d frames: mapping goes on in a new submap from frame %d on", self._searched, view.index)
        return replace(tracked.lost(T_wc), status=Status.OK, source=Source.NEW_SUBMAP)
