"""Refinement of a new keyframe's pose before the map learns it: against the frozen map (Eq. 4), or by registration."""

from abc import ABC, abstractmethod

from idfslam.alignment.aligner import MapAligner
from idfslam.alignment.alignment import Alignment, expected_error
from idfslam.config import AlignmentConfig
from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.mapping.mapper import Mapper
from idfslam.slam.place_recognition.relocaliser import Relocaliser
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Source, Tracked

# [1] Factor on `registration_prior_information`. A pose with this much information in every direction would follow a registered one by 6 %
# of the difference at most, so it is not registered. More: more keyframes are registered.
_CERTAIN = 2.0
# [1] Least score of the alignment from the registered pose over that of the tracked one. In blurred images a registration is at times wrong
# by degrees, and then fits the map worse: by 10 to 40 % on fr1/rpy. Right ones, also in corridors with bare walls, lose 5 % at most.
# More: fewer keyframes are registered.
_FITS = 0.95
# [1] Expected error of that alignment over the tracked pose's from which the latter stays. More: with scarce depth, more keyframes are
# registered although corners hold them. Chosen by hand: without corners the ratio is about 1.
_SURER = 2.0


class KeyframePose(ABC):
    """Refines the pose of keyframes that are not the first of their submap."""

    @abstractmethod
    def refine(self, keyframe: Keyframe, tracked: Tracked) -> dict[str, float]:
        """Refines the pose of a keyframe that is not stored yet; returns losses by name. tracked: its pose, and the evidence for it."""


class PoseOptimisation(KeyframePose):
    """Optimisation of the pose by gradient descent through the renderer (Eq. 4)."""

    def __init__(self, mapper: Mapper, graph: KeyframeGraph, timer: StageTimer) -> None:
        self.mapper, self.graph, self.timer = mapper, graph, timer

    def refine(self, keyframe: Keyframe, tracked: Tracked) -> dict[str, float]:
        with self.timer.stage("pose"):
            T_wk, losses = self.mapper.optimise_pose(keyframe)
        self.graph.set_pose(keyframe, T_wk)
        return losses


class KeyframeRegistration(KeyframePose):
    """Registration by the neural tracker against the last keyframe, which is the most exact where the map is bare or noisy.

    The registered pose is used only if the images of the two keyframes agree at it, and it fits map and images about as well as the tracked
    one. It is a prior of the alignment, and so acts in directions that map and images constrain weakly.
    """

    def __init__(
        self, config: AlignmentConfig, relocaliser: Relocaliser, aligner: MapAligner, graph: KeyframeGraph, timer: StageTimer
    ) -> None:
        self.config, self.relocaliser, self.aligner, self.graph, self.timer = config, relocaliser, aligner, graph, timer

    def refine(self, keyframe: Keyframe, tracked: Tracked) -> dict[str, float]:
        if tracked.source is not Source.REGISTERED:  # the front end has just registered those
            with self.timer.stage("register"):
                self._register(keyframe, tracked)
        return {}

    def _register(self, keyframe: Keyframe, tracked: Tracked) -> None:
        last = self.graph.last_keyframe
        if last is None or tracked.evidence.least_information >= _CERTAIN * self.config.registration_prior_information:
            return
        T_wc = self.relocaliser.registered(keyframe, last, near=tracked.T_wc)
        if T_wc is None or not self.relocaliser.images_agree(keyframe, last, T_wc):
            return
        aligned = self.aligner.align(keyframe, T_wc, self.graph.references(self.relocaliser.references), registered=True)
        fits = tracked.alignment is None or aligned.score >= _FITS * tracked.alignment.score
        if aligned.status is not Status.LOST and fits and not _is_surer(tracked, aligned):
            self.graph.set_pose(keyframe, aligned.T_wc)


def _is_surer(tracked: Tracked, aligned: Alignment) -> bool:
    """Whether a tracked pose is expected to be much less off than an aligned one, as where corners hold it."""
    if tracked.covariance is None or aligned.covariance is None:
        return False
    return expected_error(aligned.covariance)[0] > _SURER * expected_error(tracked.covariance)[0]


class TrackedPose(KeyframePose):
    """No refinement: the keyframe keeps its tracked pose."""

    def refine(self, keyframe: Keyframe, tracked: Tracked) -> dict[str, float]:
        return {}
