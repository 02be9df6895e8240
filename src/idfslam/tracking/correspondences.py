"""Matched points of a frame and of its keyframe, the pose estimated from them, and whether it is valid."""

from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.config import TrackerConfig
from idfslam.tracking.procrustes import ProcrustesFit, random_subsets, register
from idfslam.tracking.spatial_consistency import consistent_subsets


@dataclass(frozen=True)
class Correspondences:
    """M points seen in both images."""

    frame_uv: Tensor  # (M, 2) pixels of the frame's recorded image
    keyframe_uv: Tensor  # (M, 2) pixels of the keyframe's recorded image
    frame: Tensor  # (M, 3) points in the frame's camera frame [m]
    keyframe: Tensor  # (M, 3) points in the keyframe's camera frame [m]
    weight: Tensor  # (M,) in [0, 1]

    @staticmethod
    def none(device: torch.device) -> "Correspondences":
        """No points."""
        uv, points = torch.zeros(0, 2, device=device), torch.zeros(0, 3, device=device)
        return Correspondences(uv, uv, points, points, torch.zeros(0, device=device))

    def __len__(self) -> int:
        return len(self.weight)

    def __getitem__(self, chosen: Tensor) -> "Correspondences":
        return Correspondences(
            self.frame_uv[chosen], self.keyframe_uv[chosen], self.frame[chosen], self.keyframe[chosen], self.weight[chosen]
        )


def estimate_pose(pairs: Correspondences, config: TrackerConfig, generator: torch.Generator) -> ProcrustesFit | None:
    """T_kc by the robust Procrustes; None for too few correspondences."""
    if len(pairs) < max(3, config.min_inliers):
        return None
    count, share = config.subsets, config.subset_share
    if config.consensus == "spatial_consistency":
        subsets = consistent_subsets(pairs.frame, pairs.keyframe, subsets=count, share=share, tolerance=config.inlier_distance)
    else:
        subsets = random_subsets(len(pairs), subsets=count, share=share, generator=generator)
    fit = {"inlier_distance": config.inlier_distance, "truncation": config.truncation}
    return register(pairs.frame, pairs.keyframe, pairs.weight, subsets, refits=config.refits, **fit)


def is_valid(pose: ProcrustesFit, pairs: Correspondences, config: TrackerConfig) -> bool:
    """Whether enough of the correspondences are inliers of the pose, and lie far enough apart to determine it."""
    enough = int(pose.inliers.sum()) >= max(3, config.min_inliers, config.min_inlier_share * len(pairs))
    return enough and spans_plane(pairs.frame[pose.inliers], config.min_extent)


def spans_plane(points: Tensor, extent: float) -> bool:
    """Whether the standard deviation of points (M, 3) exceeds `extent` [m] in two directions. Points on a line leave a rotation open."""
    centred = (points - points.mean(0)).double()
    return float(torch.linalg.svdvals(centred)[1]) > extent * len(points) ** 0.5
