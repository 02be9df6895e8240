"""Methods that register two frames, behind one interface: the neural tracker, SIFT and ORB, ICP and GICP.

All matches go through the same robust Procrustes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.benchmark.icp import Cloud, IterativeClosestPoints, Variant, icp_installed
from idfslam.benchmark.keypoints import KeypointDetector, Keypoints, Kind
from idfslam.config import PAPER, FinetuneConfig, TrackerConfig
from idfslam.errors import pip_install
from idfslam.frame import Frame
from idfslam.tracking.correspondences import Correspondences, estimate_pose, is_valid
from idfslam.tracking.features import FeatureExtractor, untrained_extractor
from idfslam.tracking.frame_features import FrameFeatures
from idfslam.tracking.procrustes import ProcrustesFit
from idfslam.tracking.tracker import Tracker


@dataclass(frozen=True, eq=False)
class Estimate:
    """The pose of a frame in its keyframe, whether the method accepts it, and its inliers."""

    T_kc: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    believed: bool = False
    inliers: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 4)))  # (M, 4) pixels in frame and keyframe


def _estimate(found: Correspondences, pose: ProcrustesFit, believed: bool) -> Estimate:
    pixels = torch.cat([found.frame_uv, found.keyframe_uv], -1)[pose.inliers]
    return Estimate(pose.T_ab.numpy(), believed, pixels.double().numpy())


class Method(Protocol):
    """A method to register two frames. Its two steps are timed separately: one per frame, one per pair."""

    def describe(self, frame: Frame) -> Any: ...

    def register(self, frame: Any, keyframe: Any) -> Estimate: ...


class LearnedFeatures:
    """The neural tracker."""

    def __init__(self, config: TrackerConfig, extractor: FeatureExtractor | None = None) -> None:
        self._tracker = Tracker(config, FinetuneConfig(enabled=False), extractor=extractor)

    def describe(self, frame: Frame) -> FrameFeatures:
        return self._tracker.extract_features(frame)

    def register(self, frame: FrameFeatures, keyframe: FrameFeatures) -> Estimate:
        found, pose = self._tracker.register(frame, keyframe)
        return Estimate() if pose is None else _estimate(found, pose, self._tracker.is_consistent(pose, found, frame, keyframe))


class KeypointFeatures:
    """SIFT or ORB on the whole image with mutual matches. A pose is accepted by the paper's thresholds, without depth images."""

    def __init__(self, kind: Kind, config: TrackerConfig) -> None:
        self._detector, self._config, self._generator = KeypointDetector(kind), config, torch.Generator().manual_seed(0)

    def describe(self, frame: Frame) -> Keypoints:
        return self._detector.detect(frame)

    def register(self, frame: Keypoints, keyframe: Keypoints) -> Estimate:
        indices, weight = self._detector.match(frame, keyframe, self._config.matches)
        i, j = indices.T
        pixels = torch.from_numpy(frame.uv[i]), torch.from_numpy(keyframe.uv[j])
        points = torch.from_numpy(frame.points[i]), torch.from_numpy(keyframe.points[j])
        found = Correspondences(*pixels, *points, torch.from_numpy(weight))
        pose = estimate_pose(found, self._config, self._generator)
        return Estimate() if pose is None else _estimate(found, pose, is_valid(pose, found, PAPER.tracker))


class DepthAlone:
    """ICP that starts at the identity."""

    def __init__(self, variant: Variant) -> None:
        self._icp = IterativeClosestPoints(variant)

    def describe(self, frame: Frame) -> Cloud:
        return self._icp.cloud(frame)

    def register(self, frame: Cloud, keyframe: Cloud) -> Estimate:
        return Estimate(*self._icp.align(frame, keyframe))


def learned(config: TrackerConfig, weights: Sequence[Path]) -> dict[str, Method]:
    """The features of the config and those in `weights`, by name."""
    return {"ours": LearnedFeatures(config), **{path.stem: LearnedFeatures(replace(config, weights=path)) for path in weights}}


def baselines(config: TrackerConfig, images: torch.Tensor, report: Callable[[str], None]) -> dict[str, Method]:
    """Untrained features fitted to `images` (B, 3, h, w), SIFT, ORB, and ICP if it is installed, by name."""
    found: dict[str, Method] = {
        "untrained": LearnedFeatures(config, untrained_extractor(images)),
        "SIFT": KeypointFeatures("SIFT", config),
        "ORB": KeypointFeatures("ORB", config),
    }
    if icp_installed():
        return found | {"ICP": DepthAlone("PLANE_ICP"), "GICP": DepthAlone("GICP")}
    report(f"no rows for ICP and GICP: small_gicp is not installed: {pip_install('small_gicp')}")
    return found
