"""Whether a true trajectory is written as it is read: camera-to-world, with the camera's axes and quaternions in the order x y z w.

A trajectory in another convention has rigid poses too. The estimate tells: its positions agree with the truth and its orientations do not,
or they agree with the inverses of the true poses.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idfslam.evaluation.trajectory_error import AbsoluteTrajectoryError, absolute_trajectory_error
from idfslam.geometry.trajectory import is_rotation_determined

_AGREES = 0.2  # [1] ATE over the spread of the true positions; raised, worse runs are judged. Chosen by hand
_TURNED = 20.0  # [degrees] between orientations, in the median; raised, other axes that differ little pass. Good runs are below 3. By hand
_BETTER = 0.3  # [1] ATE with inverted poses over ATE; raised, chance decides. Chosen by hand


def wrong_convention(estimate: NDArray[np.float64], truth: NDArray[np.float64], ate: AbsoluteTrajectoryError) -> str | None:
    """What seems wrong with true poses (N, 4, 4), NaN where there are none, beside estimated ones (N, 4, 4); None: nothing.

    ate: the error of the one against the other.
    """
    found, known = estimate[ate.frames], truth[ate.frames]
    spread = float(np.linalg.norm(known[:, :3, 3].std(0)))
    if not is_rotation_determined(known[:, :3, 3]):
        return None
    if ate.translation.rmse < _AGREES * spread:
        between = known[:, :3, :3].transpose(0, 2, 1) @ ate.T_gt_est[:3, :3] @ found[:, :3, :3]
        turn = float(np.median(np.rad2deg(Rotation.from_matrix(between).magnitude())))
        expected = "expected the camera's axes (x right, y down, z forward) and quaternions as qx qy qz qw"
        return None if turn < _TURNED else f"the true positions fit the run, the orientations differ by {turn:.0f} degrees; {expected}"
    inverted = absolute_trajectory_error(found, np.linalg.inv(known).astype(np.float64)).translation.rmse
    if inverted < min(_BETTER * ate.translation.rmse, _AGREES * spread):
        return f"the inverses of the true poses fit the run ({100 * inverted:.1f} cm): expected camera-to-world, they seem world-to-camera"
    return None
