"""The variance factor a posteriori: by how much the covariance of a pose is too small, or too large, as its own residuals tell.

Two things tell it. Depth and the images of each keyframe measure the pose independently of each other: how far each would move it away from
their common solution, in standard deviations, is the Birge ratio of these measurements (Birge 1932). And where the distances to the map
exceed the sensor's noise, the excess is the map's or the calibration's. It enters twice: the residuals are larger, and neighbours share
them, so that fewer of them are independent.
"""

import numpy as np
from numpy.typing import NDArray

from idfslam.alignment.depth_term import DepthTerm
from idfslam.alignment.gauss_newton import INDEPENDENT
from idfslam.alignment.image_term import ImageTerm

Array = NDArray[np.float64]

# [1] Added to the Birge ratio: few measurements agree by chance. More: larger covariances everywhere. Chosen by hand on generated hand-held
# recordings and fr1/rpy, so that the mean NEES is near 1 on both (docs/findings.md).
_BY_CHANCE = 0.5
_SCALE_FLOOR = 1.0  # [1/m^2], [1/rad^2] Information added to each measurement's own. More: directions that it leaves open count less


def variance_factor(depth: DepthTerm, images: ImageTerm, last_step: Array, depth_noise: float) -> float:
    """The factor [1] on the covariance. The terms are those of the last step (6,), which was taken after them. depth_noise [m].

    Without two measurements that can be compared, it is that of the distances to the map alone.
    """
    ratio = max(depth.rmse / (depth_noise * depth.noise), 1.0) if depth.noise > 0 else 1.0
    return (_BY_CHANCE + _birge_ratio(depth, images, last_step, depth_noise)) * ratio**4


def _birge_ratio(depth: DepthTerm, images: ImageTerm, last_step: Array, depth_noise: float) -> float:
    """Chi-squared of the measurements about their common solution, over its degrees of freedom; 1 for fewer than two measurements."""
    measurements = [sums for sums in (depth.sums, *images.parts) if sums.H[0].any()]
    if len(measurements) < 2:
        return 1.0
    H = np.stack([sums.H[0] for sums in measurements]) / depth_noise**2
    b = np.stack([sums.b[0] for sums in measurements]) / depth_noise**2 - H @ last_step
    moved = np.linalg.solve(H + _SCALE_FLOOR * np.eye(6), b[..., None])[..., 0]
    return INDEPENDENT * float((b * moved).sum()) / (6 * (len(measurements) - 1))
