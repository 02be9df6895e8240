"""Global bundle adjustment at the end of a run: all stored keyframes and the landmarks that they share, in one problem.

Where it is trusted, its poses are final: the map learns them in the polish, and does not move them.
"""

import logging
import math
from abc import ABC, abstractmethod
from time import perf_counter
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.adjustment.bundle_adjustment import Adjusted, Problem, adjust, in_motion
from idfslam.adjustment.camera_model import NAMES, CameraModel
from idfslam.adjustment.distant_landmarks import distant_landmarks
from idfslam.adjustment.growing_tracks import GrowingTracks
from idfslam.adjustment.landmark_tracks import KeyframeView, features_of, find_tracks
from idfslam.adjustment.observations import Array, Observations, together
from idfslam.adjustment.self_calibration import noise_of
from idfslam.adjustment.shared_errors import PoseCovariances
from idfslam.geometry import se3
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.measured_edges import measured_edges
from idfslam.graph.pose_graph import RelativePoses
from idfslam.slam.keyframe_adjustment.keyframe_motion import KeyframeMotions

log = logging.getLogger(__name__)

# All of these were chosen by hand.
_LEAST_KEYFRAMES = 3  # More: short runs stay as they are
_LEAST_LANDMARKS = 100  # in all. More: runs with few landmarks stay as they are
# [px] of 640: largest noise of the landmarks at which the images agree, but for the error of a place in an image. At a width of 640 both
# make 0.35: generated recordings with 0.33 had 24 and 6 % less error after the adjustment, one with 0.39 had 70 % more, and redkitchen,
# with 0.45, 40 % more. More: blurred and contradictory recordings are adjusted, and bent.
_BENT = 0.29
# [px] Error of a place in an image, of any size. At a width of 320 both make 0.49: rooms with 0.37 to 0.43 had 14 and 23 % less error, and
# redkitchen and freiburg1_rpy have 0.69 and 1.08. More: the same in small images.
_UNSHARP = 0.2
# [1] Standard deviation of an edge, over that which loops are tested with. In generated recordings the errors of edges are 0.1 to 0.5 times
# the latter. More: landmarks that err together move keyframes that see few of them.
EDGES = 0.2
# Of which the images are in memory at once, about 1.5 MB each. Beyond, the landmarks are those that the local adjustment has found, which
# are fewer. More: longer runs are adjusted more exactly, and take more memory and time
_MOST_KEYFRAMES = 300


def reprojections_agree(seen: Observations, width: int) -> bool:
    """Whether landmarks are reprojected, into images of this width [px], as near to their corners as corners and images are exact."""
    return noise_of(seen, width) <= math.hypot(_BENT, _UNSHARP * 640 / width)


class KeyframeAdjustment(ABC):
    """Adjusts the poses of all keyframes at the end of a run."""

    adjusted: Adjusted | None = None
    """Poses and landmarks that fit best together, once they are known and trusted."""

    @abstractmethod
    def run(self) -> bool:
        """Called once, after the last frame. Returns whether the keyframes have the poses that fit best."""

    def covariances(self) -> dict[int, Array]:
        """By number of the stored keyframe: (6, 6) of xi, where T_wk exp(xi) is the true pose [m, rad], if it is known."""
        return {}

    def figures(self) -> dict[str, Any]:
        """What metrics.json reports of it."""
        return {}


class NoAdjustment(KeyframeAdjustment):
    """The keyframes stay."""

    def run(self) -> bool:
        return False


class GlobalAdjustment(KeyframeAdjustment):
    """Bundle adjustment with the camera as it is stated. The graph's edges hold what landmarks do not.

    Where the rows of an image have times of their own, each keyframe has a velocity besides its pose.
    """

    def __init__(
        self, graph: KeyframeGraph, seconds: float, tracks: GrowingTracks | None = None, motions: KeyframeMotions | None = None
    ) -> None:
        """seconds: time after which no further step begins [s], from the search of landmarks on. tracks: landmarks found during the run.

        motions: how the keyframes moved; None: their images are of one moment.
        """
        self.graph, self.seconds, self.tracks, self.motions = graph, seconds, tracks, motions

    def run(self) -> bool:
        """Moves the keyframes, and their frames with them, if the images agree.

        Blur, a wrong camera, and things that move leave landmarks beside where they are seen, and would bend the poses. Landmarks without
        depth are looked for where those with depth agree, and take part if these agree with them too.
        """
        keyframes, end = self.graph.keyframes, perf_counter() + self.seconds
        if len(keyframes) < _LEAST_KEYFRAMES:
            return False
        poses = np.array([keyframe.T_wk.numpy() for keyframe in keyframes])
        model = CameraModel.as_stated(KeyframeView.of(keyframes[0].frame).camera)
        views = [KeyframeView.of(keyframe.frame, keyframe.moving) for keyframe in keyframes] if len(keyframes) <= _MOST_KEYFRAMES else []
        images = [features_of(view, model) for view in views]
        found = find_tracks(views, images, poses, model, coarse=False) if views else self._found_during_the_run(poses)
        if len(found[0]) < _LEAST_LANDMARKS or (adjusted := self._agreed(poses, found, model, end)) is None:
            return False
        if views:
            poses = adjusted.problem.poses
            more = together([found, distant_landmarks(views, images, poses, model)])
            adjusted = (self._agreed(poses, more, model, end) if len(more[0]) > len(found[0]) else None) or adjusted
        self.graph.move([se3.orthonormal(torch.from_numpy(T.copy())) for T in adjusted.problem.poses])
        self.adjusted = adjusted
        return True

    def _found_during_the_run(self, poses: Array) -> tuple[Array, Observations]:
        """Landmarks (L, 3) [m], and where keyframes at poses T_wk (K, 4, 4) see them."""
        return together([]) if self.tracks is None else self.tracks.seen_by(np.ones(len(poses), bool), poses)

    def _agreed(self, poses: Array, landmarks: tuple[Array, Observations], model: CameraModel, end: float) -> Adjusted | None:
        """The adjustment of poses T_wk (K, 4, 4), the first of each submap fixed, until a time [s]. None if the images do not agree."""
        fixed: NDArray[np.bool_] = np.array([keyframe.host == keyframe.submap for keyframe in self.graph.keyframes])
        edges = RelativePoses.of(measured_edges(self.graph, EDGES))
        problem = Problem(model, poses, *landmarks, fixed, np.zeros(len(NAMES), bool), edges)
        if self.motions is not None:
            problem = in_motion(problem, [self.motions.of(keyframe) for keyframe in self.graph.keyframes])
        adjusted = adjust(problem, seconds=end - perf_counter())
        kept = adjusted.problem.seen
        near, width = kept[~kept.distant], model.stated.width
        log.info("bundle adjustment of %d keyframes and %d landmarks: %.2f px", *_counts(adjusted), noise_of(near, width))
        return adjusted if reprojections_agree(near, width) and adjusted.complete else None

    def covariances(self) -> dict[int, Array]:
        if self.adjusted is None:
            return {}
        covariances = PoseCovariances(self.adjusted)
        return {i: covariances.of(i) for i in range(len(self.adjusted.problem.poses))}

    def figures(self) -> dict[str, Any]:
        if self.adjusted is None:
            return {"keyframes_adjusted": False}
        return {"keyframes_adjusted": True, "landmarks": len(self.adjusted.problem.points)}


def _counts(adjusted: Adjusted) -> tuple[int, int]:
    return len(adjusted.problem.poses), len(adjusted.problem.points)
