"""Matched points of a frame and of its keyframe, the pose they give, and whether it can be believed; whatever features they came from."""

from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.config import TrackerConfig
from idfslam.tracking.procrustes import Registration, random_subsets, register
from idfslam.tracking.spatial_consistency import compatible_subsets


@dataclass(frozen=True)
class Correspondences:
    """M points seen in both images."""

    frame_uv: Tensor  # (M, 2) pixels of the recorded images
    keyframe_uv: Tensor  # (M, 2)
    frame: Tensor  # (M, 3) points in each camera's own frame [m]
    keyframe: Tensor  # (M, 3)
    weight: Tensor  # (M,) in [0, 1]

    def __len__(self) -> int:
        return len(self.weight)

    def __getitem__(self, chosen: Tensor) -> "Correspondences":
        return Correspondences(
            self.frame_uv[chosen], self.keyframe_uv[chosen], self.frame[chosen], self.keyframe[chosen], self.weight[chosen]
        )


def estimate_pose(found: Correspondences, config: TrackerConfig, generator: torch.Generator) -> Registration | None:
    """T_kc by the robust Procrustes; None where there are too few correspondences to say anything."""
    if len(found) < max(3, config.min_inliers):
        return None
    subsets, share = config.subsets, config.subset_share
    if config.consensus == "spatial_consistency":
        tried = compatible_subsets(found.frame, found.keyframe, subsets=subsets, share=share, tolerance=config.inlier_distance)
    else:
        tried = random_subsets(len(found), subsets=subsets, share=share, generator=generator)
    fit = {"inlier_distance": config.inlier_distance, "truncation": config.truncation}
    return register(found.frame, found.keyframe, found.weight, tried, refits=config.refits, **fit)


def believable(pose: Registration, found: Correspondences, config: TrackerConfig) -> bool:
    """Whether enough of the correspondences support the pose, and spread enough to hold it."""
    enough = int(pose.inliers.sum()) >= max(3, config.min_inliers, config.min_inlier_share * len(found))
    return enough and spans_plane(found.frame[pose.inliers], config.min_extent)


def spans_plane(points: Tensor, extent: float) -> bool:
    """Whether points (M, 3) spread (standard deviation) by more than `extent` [m] in two directions; on a line a rotation stays free."""
    centred = (points - points.mean(0)).double()
    return float(torch.linalg.svdvals(centred)[1]) > extent * len(points) ** 0.5
