"""The parts of a system, made from its configuration. No other place does this.

A new front end, map or back end is one class and one line in FRONT_ENDS, MAPS or BACK_ENDS (docs/design.md has an example).
"""

from collections.abc import Callable
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.alignment.aligner import MapAligner
from idfslam.alignment.motion import MotionModel
from idfslam.compute.devices import resolve_device, seeded, updates_may_overlap
from idfslam.config import Config
from idfslam.errors import ConfigError
from idfslam.graph.coverage import Coverage
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.information_gain import InformationGain
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.keyframe_interval import KeyframeInterval
from idfslam.graph.keyframe_selection import KeyframeSelection
from idfslam.graph.replay import Replay
from idfslam.mapping.compiled_field import distance_query
from idfslam.mapping.joint.density_map import DensityMap
from idfslam.mapping.joint.grids_map import GridsMap
from idfslam.mapping.joint.joint_map import JointMap
from idfslam.mapping.map import Map
from idfslam.mapping.mapper import Mapper
from idfslam.mapping.updates import InBackground, InTurns
from idfslam.sensing.rectification import RowTimes
from idfslam.slam.back_end.back_end import BackEnd, KeyframeMapping
from idfslam.slam.back_end.finetuner import Finetuner, Finetuning, NoFinetuning
from idfslam.slam.back_end.joint_mapping import JointMapping
from idfslam.slam.back_end.keyframe_pose import KeyframePose, KeyframeRegistration, PoseOptimisation, TrackedPose
from idfslam.slam.back_end.light_estimation import LightEstimation
from idfslam.slam.back_end.map_training import MapTraining
from idfslam.slam.back_end.mapping_window import LossWindow, MappingWindow, OverlapWindow
from idfslam.slam.back_end.polish import NoPolish, Polish, Polishing
from idfslam.slam.back_end.refinement import KeyframeRefinement, NoRefinement, Refinement
from idfslam.slam.back_end.relearn_queue import RelearnQueue
from idfslam.slam.back_end.surface_fusion import NoFusion, SurfaceFusion, ViewFusion
from idfslam.slam.front_end.alignment_to_map import AlignmentToMap
from idfslam.slam.front_end.front_end import FrontEnd
from idfslam.slam.front_end.inverse_rendering import InverseRendering
from idfslam.slam.front_end.registration import Registration
from idfslam.slam.front_end.scarce_depth import ScarceDepth
from idfslam.slam.keyframe_adjustment.camera_check import CameraCheck
from idfslam.slam.keyframe_adjustment.frame_resection import FrameResection, NoResection, Resection
from idfslam.slam.keyframe_adjustment.global_adjustment import GlobalAdjustment, KeyframeAdjustment, NoAdjustment
from idfslam.slam.keyframe_adjustment.keyframe_corners import KeyframeCorners
from idfslam.slam.keyframe_adjustment.keyframe_motion import KeyframeMotions
from idfslam.slam.keyframe_adjustment.local_adjustment import LocalAdjustment
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.slam.keyframe_hook import KeyframeHook
from idfslam.slam.motion_segmentation.hindsight import FreeSpaceHindsight, Hindsight, NoHindsight
from idfslam.slam.motion_segmentation.motion_segmentation import FreeSpaceSegmentation, MotionSegmentation, NoSegmentation
from idfslam.slam.place_recognition.loop_closer import LoopCloser
from idfslam.slam.place_recognition.recovery import NoRecovery, Recovery, Relocalisation
from idfslam.slam.place_recognition.relocalisation_check import RelocalisationCheck
from idfslam.slam.place_recognition.relocaliser import Relocaliser
from idfslam.slam.place_recognition.submap_merger import SubmapMerger
from idfslam.slam.stage_timer import StageTimer
from idfslam.tracking.tracker import Tracker
from idfslam.views.view_selection import ViewSelection

Part = TypeVar("Part")


class System:
    """The parts of one system. Each is made on first use and shared."""

    def __init__(
        self,
        config: Config,
        *,
        front_end: "Callable[[System], FrontEnd] | None" = None,
        back_end: "Callable[[System], BackEnd] | None" = None,
        map: "Callable[[System], Map] | None" = None,
    ) -> None:
        """front_end, back_end, map: make these parts instead of those that the configuration names."""
        self.config, self.device = config, resolve_device(config.device, config.preset)
        self._make_front_end = front_end or _named(FRONT_ENDS, "front_end", config.front_end)
        self._make_back_end = back_end or _named(BACK_ENDS, "back_end", config.back_end)
        self._make_map = map or _named(MAPS, "map_representation", config.map_representation)
        self.generator = torch.Generator().manual_seed(config.seed)  # for all random draws on the CPU while frames are processed
        self.timer, self.motion = StageTimer(), MotionModel()
        self.tracker, self.map = self._networks()
        self.graph = KeyframeGraph(config.keyframes, verify=self.closes_loops)
        self.frames, self.coverage = FramePoses(self.graph), Coverage(self.graph)
        self.views = ViewSelection(self.frames, config.archive_megabytes if config.archive else 0.0)
        self.replay, self.relearn = Replay(config.keyframes, self.graph, self.generator), RelearnQueue(config.loops.relearn_updates)
        self.features = KeyframeFeatures(self.tracker)
        if config.mapper.light:
            self.map.light = self.light.later
        self.front_end = self._make_front_end(self)
        self.back_end = self._make_back_end(self)

    def _networks(self) -> tuple[Tracker, Map]:
        """The tracker and the map. Torch's global generator initialises their weights; it is seeded for that and then restored."""
        with seeded(self.config.seed):
            tracker = Tracker(self.config.tracker, self.config.finetune, self.device, self.config.seed)
            return tracker, self._make_map(self)

    @property
    def mapper(self) -> Mapper:
        """The map, if it learns from frames with fixed poses. Raises ConfigError for another one."""
        if not isinstance(self.map, Mapper):
            raise ConfigError(self._unfit("neural_field"))
        return self.map

    @property
    def joint_map(self) -> JointMap:
        """The map, if it is optimised together with poses. Raises ConfigError for another one."""
        if not isinstance(self.map, JointMap):
            raise ConfigError(self._unfit("volume_density or occupancy_grids"))
        return self.map

    def _unfit(self, expected: str) -> str:
        c = self.config
        return f"map_representation '{c.map_representation}', expected {expected} for front_end '{c.front_end}' and back_end '{c.back_end}'"

    @property
    def aligns(self) -> bool:
        """Whether frames are aligned to the map."""
        return self.config.front_end == "alignment"

    @property
    def closes_loops(self) -> bool:
        return self.config.loops.enabled and self.aligns

    @property
    def relocalises(self) -> bool:
        return self.config.loops.relocalise and self.aligns

    # Front end: the pose of each frame

    @cached_property
    def aligner(self) -> MapAligner:
        if isinstance(self.map, JointMap):
            c = self.config
            found = f"front_end 'alignment' with map_representation '{c.map_representation}', expected neural_field"
            raise ConfigError(f"{found}: frames are aligned to a signed distance; choose front_end inverse_rendering for this map")
        query = distance_query(self.map.published)
        return MapAligner(self.config.alignment, query, self.config.field.truncation, self.generator, self.coverage.observed.contains)

    @cached_property
    def registration(self) -> Registration:
        return Registration(self.tracker, self.features, self.graph, self.timer)

    # Place recognition: a lost camera, loops, submaps

    @cached_property
    def relocaliser(self) -> Relocaliser:
        return Relocaliser(self.tracker, self.features, self.aligner, self.graph, references=self.config.alignment.references)

    @cached_property
    def relocalisation_check(self) -> RelocalisationCheck:
        return RelocalisationCheck(self.aligner, self.graph, self.frames)

    @cached_property
    def recovery(self) -> Recovery:
        if not self.relocalises:
            return NoRecovery(self.graph, self.frames)
        return Relocalisation(self.config.loops, self.relocaliser, self.relocalisation_check, self.graph, self.frames, self.timer)

    # What moves

    @cached_property
    def segmentation(self) -> MotionSegmentation:
        if self.config.movers == "off":
            return NoSegmentation()
        references = partial(self.graph.references, self.config.alignment.references)
        return FreeSpaceSegmentation(self.frames, self.timer, masked=self._learn_masked, references=references)

    def _learn_masked(self, keyframe: Keyframe) -> None:
        """Has all parts take up the changed mask of a stored keyframe."""
        if self.aligns:
            self.aligner.appearances.forget(keyframe)
        if self.local_adjustment is not None:
            self.local_adjustment.hide(keyframe)
        self.coverage.replace(keyframe)
        self.relearn.add([keyframe])

    @cached_property
    def hindsight(self) -> Hindsight:
        if not isinstance(self.segmentation, FreeSpaceSegmentation):
            return NoHindsight()
        return FreeSpaceHindsight(self.segmentation, self.frames, self.coverage, self.views, self.timer)

    # Keyframes: which frames become one, their poses, and what is called with each

    @cached_property
    def keyframe_selection(self) -> KeyframeSelection:
        parts, lost_frames = (self.config.keyframes, self.graph, self.frames), not self.relocalises
        if self.config.keyframes.choice == "information_gain":
            return InformationGain(*parts, self.joint_map.explained, lost_frames=lost_frames)
        interval = self.config.keyframes.choice == "interval"
        return (KeyframeInterval if interval else KeyframeSelection)(*parts, lost_frames=lost_frames)

    @cached_property
    def keyframe_pose(self) -> KeyframePose:
        if self.config.mapper.pose_optimisation:
            return PoseOptimisation(self.mapper, self.graph, self.timer)
        if not self.aligns:
            return TrackedPose()
        return KeyframeRegistration(self.config.alignment, self.relocaliser, self.aligner, self.graph, self.timer)

    @cached_property
    def hooks(self) -> list[KeyframeHook]:
        hooks = list[KeyframeHook]()
        if self.config.mapper.light:
            hooks.append(self.light)
        if self.relocalises:
            hooks.append(self.relocalisation_check)
        if self.local_adjustment is not None:
            hooks.append(self.local_adjustment)
        if self.closes_loops:
            hooks.append(LoopCloser(self.config.loops, self.relocaliser, self.graph))
            hooks.append(SubmapMerger(self.config.loops, self.relocaliser, self.graph, self.frames))
        if self.config.calibrate != "off":
            hooks.append(self._camera_check())
        return hooks

    @cached_property
    def light(self) -> LightEstimation:
        return LightEstimation(self.graph, self.aligner.appearances.take_out) if self.aligns else LightEstimation(self.graph)

    def _camera_check(self) -> CameraCheck:
        def times(keyframe: Keyframe) -> RowTimes:
            return self.front_end.likeliest_row_times(keyframe)[0]

        def deviations(keyframe: Keyframe) -> NDArray[np.float64]:
            return self.front_end.likeliest_row_times(keyframe)[1]

        return CameraCheck(self.graph, KeyframeMotions(self.frames, times), deviations)

    # Adjustment: keyframes with the landmarks that they share, and the frames between them

    @cached_property
    def motions(self) -> KeyframeMotions:
        return KeyframeMotions(self.frames, lambda keyframe: self.front_end.row_times(keyframe))  # the front end is made later

    @cached_property
    def local_adjustment(self) -> LocalAdjustment | None:
        return LocalAdjustment(self.graph, self.features, self.motions) if self.aligns and self.config.refinement.adjust_local else None

    @cached_property
    def adjustment(self) -> KeyframeAdjustment:
        if not (self.aligns and self.config.refinement.adjust):
            return NoAdjustment()
        tracks = None if self.local_adjustment is None else self.local_adjustment.tracks
        return GlobalAdjustment(self.graph, self.config.refinement.seconds, tracks, self.motions)

    @cached_property
    def corners(self) -> KeyframeCorners:
        local = self.local_adjustment
        return KeyframeCorners(self.graph, self.features) if local is None else KeyframeCorners(self.graph, self.features, local.distant)

    @cached_property
    def resection(self) -> Resection:
        if isinstance(self.adjustment, NoAdjustment):
            return NoResection()
        local = self.local_adjustment
        agree = (lambda: True) if local is None else (lambda: local.agrees)
        return FrameResection(self.graph, self.frames, self.corners, self.adjustment, agree)

    # Back end: what the map learns, and the end of a run

    @cached_property
    def mapping_window(self) -> MappingWindow:
        parts = self.config.joint_mapping, self.graph, self.generator
        if self.config.joint_mapping.choice == "overlap":
            return OverlapWindow(*parts)
        return LossWindow(*parts, self.joint_map.loss_of)

    @cached_property
    def refinement(self) -> Refinement:
        if not self.aligns:
            return NoRefinement()
        held = (lambda keyframe: False) if self.local_adjustment is None else self.local_adjustment.holds
        references = self.config.alignment.references
        return KeyframeRefinement(self.config.refinement, self.graph, self.relearn, self.aligner, held, references=references)

    @cached_property
    def finetuner(self) -> Finetuning:
        if not self.config.finetune.enabled:
            return NoFinetuning()
        return Finetuner(self.tracker, self.features, self.mapper, self.graph, self.timer)

    @cached_property
    def polish(self) -> Polishing:
        if not self.config.refine:
            return NoPolish()
        c = self.config
        return Polish(
            c.refinement, c.mapper.iterations, self.graph, self.replay, self.relearn, self.adjustment, self.refinement, self.mapper
        )

    @cached_property
    def surface_fusion(self) -> SurfaceFusion:
        return ViewFusion(self.config.fusion, self.graph, self.coverage) if self.config.fusion.enabled else NoFusion()


def _neural_field(s: System) -> Mapper:
    background = s.config.mapper.background and updates_may_overlap(s.device)
    updates = InBackground() if background else InTurns()
    return Mapper(s.config.mapper, s.config.field, s.device, torch.Generator(s.device).manual_seed(s.config.seed), updates)


def _volume_density(s: System) -> Map:
    return DensityMap(s.config, s.device, torch.Generator(s.device).manual_seed(s.config.seed))


def _occupancy_grids(s: System) -> Map:
    return GridsMap(s.config, s.device, torch.Generator(s.device).manual_seed(s.config.seed))


def _alignment(s: System) -> FrontEnd:
    def train_now(keyframe: Keyframe) -> None:
        s.back_end.learn_again(keyframe)  # which is made after the front end

    parts = s.aligner, s.registration, s.graph, s.frames, s.timer
    front_end = partial(AlignmentToMap, *parts, train_now=train_now, queue_for_training=s.relearn.add)
    if isinstance(s.resection, NoResection):  # nobody learns how far away corners are
        return front_end()
    return front_end(resect=ScarceDepth(s.corners).resected)


def _registration(s: System) -> FrontEnd:
    return s.registration


def _inverse_rendering(s: System) -> FrontEnd:
    return InverseRendering(s.joint_map, s.timer)


def _joint_mapping(s: System) -> BackEnd:
    on_keyframe = s.joint_map.lock if s.config.keyframes.choice == "information_gain" else lambda: None
    return JointMapping(s.config, s.graph, s.frames, s.coverage, s.joint_map, s.mapping_window, s.timer, on_keyframe)


def _keyframe_mapping(s: System) -> BackEnd:
    updates = MapTraining(s.config, s.graph, s.frames, s.replay, s.relearn, s.mapper, s.refinement, s.timer)
    return KeyframeMapping(
        s.config, s.graph, s.frames, s.coverage, s.features, s.keyframe_pose, s.hooks, updates, s.polish, s.finetuner, s.timer
    )


FRONT_ENDS: dict[str, Callable[[System], FrontEnd]] = {
    "alignment": _alignment,
    "registration": _registration,
    "inverse_rendering": _inverse_rendering,
}
MAPS: dict[str, Callable[[System], Map]] = {
    "neural_field": _neural_field,
    "volume_density": _volume_density,
    "occupancy_grids": _occupancy_grids,
}
BACK_ENDS: dict[str, Callable[[System], BackEnd]] = {"keyframe_mapping": _keyframe_mapping, "joint_mapping": _joint_mapping}


def _named(table: dict[str, Part], key: str, name: str) -> Part:
    if name not in table:
        raise ConfigError(f"{key} '{name}', expected one of {', '.join(table)}")
    return table[name]
