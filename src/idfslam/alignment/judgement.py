"""How good an alignment is: its status and covariance, by what depth, images and shading say of the pose that it ended at."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from idfslam.alignment.alignment import TELLING_SHARE, Alignment
from idfslam.alignment.continuous_motion import JointEstimate
from idfslam.alignment.depth_term import DepthTerm
from idfslam.alignment.gauss_newton import information_scale
from idfslam.alignment.image_term import ImageTerm
from idfslam.alignment.motion import Information
from idfslam.alignment.pose_doubt import PoseDoubt
from idfslam.alignment.row_moments import Array, PoseEquations
from idfslam.alignment.variance_factor import variance_factor
from idfslam.config import AlignmentConfig
from idfslam.frame import Status
from idfslam.geometry import se3

# All of these were chosen by hand on generated rooms and redkitchen.

# [1] Ratio of the RMSE to that of the sensor's noise alone, up to which an alignment is not lost: 1.5 times that of two readings, since a
# map of one view has the same noise. More: wrong poses at the end of the sensor's range are accepted. Right ones have 1 to 1.6 there.
_NOISE_MARGIN = 1.5 * 2**0.5
# [1] Information of the noise of the map's normals, over that of a degenerate direction, which is taken out of depth that is alone. Twice,
# since it varies, as in `shading`: bare floors of rooms 3 and 10 have 0.5 to 2.8 with a Kinect's noise, their furniture 3.4 to 8. More:
# depth alone holds poses less, and more of them are degenerate.
_BY_NOISE = 2.0
# [m], [rad] Standard deviation that is told of a direction that nothing measures. More: bare walls look less certain.
_UNMEASURED = 0.1


@dataclass(frozen=True, eq=False)
class LastStep:
    """The last step of an alignment: the pose after it, and what told of the pose."""

    T_wc: Tensor  # (4, 4) the pose
    change: Array  # (6,) of the pose in this step
    depth: DepthTerm
    images: ImageTerm
    shading: PoseEquations
    displacement: float  # [rad] of the image at the pose; 0: unknown
    focal: float  # focal length of the finest image [px]
    has_depth: bool  # whether the view has enough depth; without it, `depth` says nothing
    joint: JointEstimate | None = None  # of pose and velocity; None: the pose was estimated alone
    steps: int = 0  # in all


def judged(last: LastStep, doubt: PoseDoubt, config: AlignmentConfig) -> Alignment:
    """The alignment that ended with this step. doubt: tells whether the image contradicts the pose."""
    depth, images = last.depth, last.images
    of_depth = Information.of(depth.H, depth.weight, depth.radius)
    contradicted = doubt.is_doubtful(last.displacement)  # images that do not match say nothing about the motion
    alignment = Alignment(
        T_wc=se3.orthonormal(last.T_wc),
        status=_of_depth(last, of_depth, config) if last.has_depth else _of_images(images, contradicted=contradicted),
        overlap=depth.overlap,
        rmse=depth.rmse,
        min_eigenvalue=float(of_depth.values[0]),
        photometric_error=images.photometric_error,
        in_view=images.in_view,
        information=of_depth if contradicted else Information.of(_together(last), depth.weight, depth.radius),
        iterations=last.steps,
        covariance=_covariance(last, config.depth_noise),
        joint=last.joint,
        focal=last.focal,
        radius=depth.radius,
        displacement=last.displacement,
    )
    return replace(alignment, status=Status.DEGENERATE) if alignment.status is Status.OK and alignment.is_unsure else alignment


def reliable(depth: DepthTerm, config: AlignmentConfig) -> DepthTerm:
    """Depth that is alone, without what the noise of the map's normals seems to tell: pose and velocity would run away with it."""
    information = Information.of(depth.H, depth.weight, depth.radius)
    return replace(depth, sums=information.reliable(depth.sums, _by_noise(config)))


def _by_noise(config: AlignmentConfig) -> float:
    """[1] information that the noise of the map's normals gives in a direction that depth does not measure."""
    return _BY_NOISE * config.min_eigenvalue


def _of_depth(last: LastStep, information: Information, config: AlignmentConfig) -> Status:
    """The status by the distances to the map, which have this information."""
    largest = max(config.max_rmse, _NOISE_MARGIN * config.depth_noise * last.depth.noise)
    if last.depth.overlap < config.min_overlap or last.depth.rmse > largest:
        return Status.LOST
    alone = last.joint is None and not last.images.parts  # with a velocity, the covariance tells what depth leaves open
    least = float(information.values[0]) - (_by_noise(config) if alone else 0.0)
    return Status.DEGENERATE if least < config.min_eigenvalue else Status.OK


def _of_images(images: ImageTerm, *, contradicted: bool) -> Status:
    """The status of a view without depth."""
    confirmed = images.in_view > TELLING_SHARE and images.photometric_error > 0 and not contradicted
    return Status.DEGENERATE if confirmed else Status.LOST


def _together(last: LastStep) -> Tensor:
    """(6, 6) the normal equations of all that told of the pose."""
    return last.depth.H + last.images.H + last.shading.H


def _covariance(last: LastStep, depth_noise: float) -> Tensor:
    """(6, 6) of the pose, with its variance factor. A direction that nothing measures has the deviation `_UNMEASURED`. depth_noise [m]."""
    if last.joint is not None:
        told = torch.from_numpy(last.joint.covariance[:6, :6].copy())
    else:
        prior = torch.tensor([1 / _UNMEASURED**2] * 6, dtype=torch.float64)
        told = torch.linalg.inv(information_scale(depth_noise) * _together(last) + torch.diag(prior))
    return told * variance_factor(last.depth, last.images, last.change, depth_noise)
