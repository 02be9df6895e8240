"""The result of aligning a frame: its pose, and how well depth and images constrain and confirm it."""

import math
from dataclasses import dataclass

from torch import Tensor

from idfslam.alignment.continuous_motion import JointEstimate
from idfslam.alignment.motion import Information, image_motion
from idfslam.frame import Status

# All of these were chosen by hand.
# [1] Photometric error of a landmark that shows another place. More: landmarks out of view count more against a pose.
_WRONG_ERROR = 0.1
# [1], [m] Added to the photometric error and to the RMSE in a score. More: small differences decide less.
_ERROR_FLOOR, _RMSE_FLOOR = 0.005, 0.003
# [m], [rad] Error above which a pose is off: the 5 cm and 2 degrees of `idfslam.evaluation.doubt`. A pose is degenerate if more is expected
# of it (root mean square, by its covariance), and of two poses of one view that differ by more one is wrong. More: poses that hardly
# anything measures are called ok, wrong ones are noticed later, and fewer right ones are doubtful.
OFF = 0.05, math.radians(2)
# [1] Least share of the references' landmarks in view for the image to tell whether a pose is right. More: poses are confirmed and refuted
# less often, and more safely; doubts last longer in new ground, and new submaps begin sooner.
TELLING_SHARE = 0.3


@dataclass(frozen=True)
class Alignment:
    """The pose of a frame, and how well depth and images constrain and confirm it."""

    T_wc: Tensor  # (4, 4) float64
    status: Status
    overlap: float  # share of the points that lie near a mapped surface; 1 for a frame without depth
    rmse: float  # [m] of the robustly weighted distances
    min_eigenvalue: float  # smallest eigenvalue of the information of depth, per unit weight [1]; small: degenerate
    photometric_error: float  # scale of the brightness differences to the references' landmarks in view [1]; 0 without landmarks
    in_view: float  # share of the references' landmarks that are in view; 1 without landmarks
    information: Information | None  # of depth and images together, of depth alone if the images contradict it; None: neither
    iterations: int
    covariance: Tensor | None = None  # (6, 6) of shift [m] and turn [rad] along world axes; None: neither depth nor landmarks
    joint: JointEstimate | None = None  # velocity, and covariance with the pose; None: the pose was estimated alone
    focal: float = 1.0  # focal length of the finest image [px]
    radius: float = 1.0  # mean distance of the points, or without depth of the landmarks [m]
    displacement: float = 0.0  # [rad] that would explain the brightness differences (`displacement.displacement`); 0 without landmarks

    @property
    def least_information(self) -> float:
        """Smallest eigenvalue of the information of depth and images, per unit weight [1]; 0 without information."""
        return 0.0 if self.information is None else float(self.information.values[0])

    @property
    def is_unsure(self) -> bool:
        """Whether the pose is expected to be far off, by its own covariance: depth and images hardly measure it."""
        if self.covariance is None:
            return False
        shift, turn = expected_error(self.covariance)
        return shift > OFF[0] or turn > OFF[1]

    @property
    def score(self) -> float:
        """Quality of an alignment, to compare several of one view: overlap over photometric error and RMSE; 0 if lost.

        A landmark out of view counts as a wrong one. Otherwise a pose that looks away from all landmarks would score best.
        """
        agreement = self.in_view / (self.photometric_error + _ERROR_FLOOR) + (1 - self.in_view) / (_WRONG_ERROR + _ERROR_FLOOR)
        return 0.0 if self.status is Status.LOST else self.overlap * agreement / (self.rmse + _RMSE_FLOOR)

    def distance(self, T_wc: Tensor) -> float:
        """About how far the finest image moves between this pose and another one (4, 4) [px]."""
        return self.focal * image_motion(T_wc, self.T_wc, self.radius)


def expected_error(covariance: Tensor) -> tuple[float, float]:
    """The error (root mean square) of a pose with this covariance (6, 6) of shift [m] and turn [rad]: [m], [rad]."""
    variances = covariance.diagonal()
    return math.sqrt(float(variances[:3].sum())), math.sqrt(float(variances[3:].sum()))
