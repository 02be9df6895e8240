"""A registration refined by all that two frames show: the image by aligned patches, and depth by planes, weighed against each other.

Each is exact where the sensor is ideal, and they agree there. On a real sensor both have systematic errors: depth is warped, or was taken
at another time than the image, lenses distort, and shutters roll. Where the two differ much and few patches of the image support the pose
with depth, the image decides, because the pose is the colour camera's. The more they differ, the larger is the covariance.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.geometry import se3
from idfslam.tracking.correspondences import Correspondences
from idfslam.tracking.frame_features import FrameFeatures
from idfslam.tracking.patch_alignment import AlignedPatches, aligned_patches
from idfslam.tracking.point_to_plane import plane_system, point_to_plane
from idfslam.tracking.procrustes import ProcrustesFit, supported

# All of these were chosen on generated pairs, photographs and a hand-held recording (docs/model-card.md).
_STRIDE = 2  # [px] stride of the rows and columns whose planes take part. More: faster, and depth counts less
_REACH = (0.06, 0.03, 0.03)  # [m] largest distance of a point from its plane, in each step. More: outliers take part
_SCALE = 3.0  # [standard deviations] scale of the robust weights of patches. More: outliers count more
# [1] Weight of a patch relative to a point of depth, because patches share their systematic errors. More: the image counts more.
_PATCH_WEIGHT = 0.1
_WEIGHTS = (1.0, 0.1, 0.01, 0.0)  # [1] weights of depth that are tried in turn. More of them: finer steps, slower where depth contradicts
# [rad] Motion of the image by which the pose with depth may differ from the image's whatever the support, because lenses distort and
# shutters roll. More: depth counts more.
_CONTRADICTION = 0.003
_PRIOR = 1.0  # [1/m^2, 1/rad^2] information at the present pose. It keeps the system solvable, and a point has about 10^4.
#    More: shorter steps
# [1], [1/rad^2], [rad] The covariance is the inverse information times the sum of the first and of the second times the squared
# contradiction, at most the third. More: larger covariances.
_LEAST_VARIANCE, _VARIANCE, _MOST = 0.07, 3e6, 0.005


@dataclass(frozen=True)
class RefinedRegistration(ProcrustesFit):
    """A registration by image and depth, and its evidence."""

    covariance: Tensor  # (6, 6) float64 of delta, where exp(delta) T_ab is the true pose [m, rad]
    patches: AlignedPatches


@torch.no_grad()
def refined(
    pose: ProcrustesFit, pairs: Correspondences, frame: FrameFeatures, keyframe: FrameFeatures, *, plane_steps: int, inlier_distance: float
) -> RefinedRegistration | None:
    """The registration of a frame from one by matches; None if too few patches can be aligned.

    plane_steps: steps of point-to-plane ICP; with 0, depth does not take part. inlier_distance: of the matches [m].
    """
    by_image = aligned_patches(pose.T_ab, frame, keyframe)
    if by_image is None:
        return None
    T_kc, patches = by_image
    contradiction = 0.0  # [rad] median motion of the image between the poses by image and depth
    T_start = point_to_plane(pose.T_ab, frame, keyframe, pairs[pose.inliers], steps=plane_steps).cpu()
    for weight in _WEIGHTS if plane_steps > 0 else _WEIGHTS[-1:]:
        T, H = _together(T_start, frame, keyframe, patches, weight)
        T_start = T_kc  # depth's own pose is left where the image contradicts it
        contradiction = max(contradiction, patches.distance(T_kc, T) / patches.camera.fx)
        if patches.agree(T, T_kc) or contradiction < _CONTRADICTION:
            break
    inflation = _LEAST_VARIANCE + _VARIANCE * min(contradiction, _MOST) ** 2
    found = supported(se3.orthonormal(T).to(pose.T_ab), pairs.frame, pairs.keyframe, inlier_distance)
    return RefinedRegistration(found.T_ab, found.inliers, found.rmse, inflation * torch.linalg.inv(H), patches)


def _together(T_kc: Tensor, frame: FrameFeatures, keyframe: FrameFeatures, patches: AlignedPatches, weight: float) -> tuple[Tensor, Tensor]:
    """T_kc (4, 4) by image and depth together, and the information (6, 6); `weight` is that of depth."""
    for reach in _REACH:
        H, b = patches.system(T_kc, _SCALE)
        H, b = _PATCH_WEIGHT * H + _PRIOR * torch.eye(6, dtype=torch.float64), _PATCH_WEIGHT * b
        if weight > 0:
            H_planes, b_planes = plane_system(T_kc, frame, keyframe, _STRIDE, reach)
            H, b = H + weight * H_planes.cpu(), b + weight * b_planes.cpu()
        T_kc = se3.exp(torch.linalg.solve(H, b)) @ T_kc
    return T_kc, H
