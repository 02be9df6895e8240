"""Where little depth holds a pose, corners without depth do, once it is known how far away they are.

A sensor of short reach sees a tenth of a large room with depth, and all of it with colour. How far away a corner is follows from the frames
since its keyframe, or from the adjustment of the last keyframes. Corners with depth are left to the alignment: each keyframe's readings err
together, and would draw frames to that keyframe instead of to the map.
"""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from idfslam.adjustment.resection import resected, with_spread
from idfslam.alignment.alignment import Alignment, expected_error
from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe
from idfslam.slam.front_end.registered_pose import are_apart
from idfslam.slam.keyframe_adjustment.keyframe_corners import SCARCE, KeyframeCorners
from idfslam.tracking.frame_features import brightness
from idfslam.tracking.patch_alignment import AlignedPatches

# All of these were chosen by hand on rooms larger than a Kinect's reach.
_LEAST = 8  # corners of known distance in view. More: corners are asked in fewer frames
_VARIANCE = 12.0  # [1] of a corner's place in both images, over that of one as its patch tells it. More: corners hold poses less
# [standard deviations] of a corner that agrees with the pose, and least share of such corners. More: corners that moved draw poses along
_AGREES, _AGREE = 3.0, 0.6


class ScarceDepth:
    """Resects frames from corners where their depth leaves a pose unsure."""

    def __init__(self, corners: KeyframeCorners) -> None:
        self.corners, self.graph = corners, corners.graph

    def resected(self, view: Keyframe, aligned: Alignment) -> Alignment:
        """An alignment with the pose and covariance that it and corners give together. The view is at its predicted pose.

        The alignment itself where it is sure, lost, or of an image whose rows are of several moments, and where corners tell nothing.
        """
        covariance = aligned.covariance
        usable = view.rectification is None and not view.colour_is_older and aligned.status is not Status.LOST
        if covariance is None or not (usable and self.graph.keyframes) or expected_error(covariance)[0] <= SCARCE:
            return aligned
        ran_away = aligned.is_unsure and are_apart(view.T_wk, aligned.T_wc)
        seen = self._seen(view, view.T_wk if ran_away else aligned.T_wc)
        if len(seen) < _LEAST:
            return aligned
        T_wc = resected(aligned.T_wc, covariance, seen)
        if float((seen.residuals(T_wc) < _AGREES).double().mean()) < _AGREE:
            return aligned
        by_turn = torch.eye(6, dtype=torch.float64)  # the step of `AlignedPatches.system` that turns the camera about its centre
        by_turn[:3, 3:] = se3.hat(T_wc[:3, 3])
        information = torch.linalg.inv(covariance) + by_turn.T @ seen.system(T_wc, _AGREES)[0] @ by_turn
        return replace(aligned, T_wc=T_wc, covariance=torch.linalg.inv(information))

    def _seen(self, view: Keyframe, T_wc: Tensor) -> AlignedPatches:
        """The corners of known distance of the last keyframe that a view at about T_wc (4, 4) shows, in the world."""
        number, _ = self.graph.relative_to_host(T_wc)
        self.corners.begin(number)
        host, keyframe = self.corners.hosts[-1], self.graph.keyframes[number]
        seen = self.corners.search(torch.from_numpy(brightness(view.frame)), T_wc, view.moving)
        seen = seen[np.append(np.zeros(len(host.near), bool), host.distant.are_known)[seen.corner]]
        z, sigma = (torch.from_numpy(part[seen.corner])[:, None] for part in host.depth())
        rays, nothing = (
            torch.from_numpy(host.distant.rays[seen.corner - len(host.near)]),
            torch.zeros(len(seen.corner), dtype=torch.float64),
        )
        information = torch.linalg.inv(torch.from_numpy(_VARIANCE * seen.covariance))
        points, camera = se3.transform(keyframe.T_wk, z * rays), self.corners.features.images_of(keyframe).grey_camera
        patches = AlignedPatches(points, torch.from_numpy(seen.uv), information, nothing, nothing, camera)
        return with_spread(patches, T_wc, sigma * rays @ keyframe.T_wk[:3, :3].T)
