"""How much of a keyframe's correction the frame before it needs too: as much as leaves the motion of the camera even.

Where errors have grown slowly, the frame before a keyframe is off by about as much. Where something that moves has drawn the keyframe's own
frame away, the frame before is not: what corrects the keyframe would move it away. The motion tells the two apart, by least squares.
"""

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.pose_distance import AHEAD

Array = NDArray[np.float64]

# All of them were chosen by hand on generated rooms with people.
# [1] Standard deviation of the share from all of the correction. Up to about ten times what the motion is usually uneven by, corrections
# are shared. Rooms 6 and 4 had errors of 0.314 and 0.310 cm with 0.08, of 0.309 and 0.315 with 1, and of 0.469 and 0.308 where all were
# shared. More: smaller ones are kept from the frames before
_UNSHARED = 0.1
_LEAST_USUAL = 5e-4  # [m] by which motions count as uneven at least. More: the same, in exact poses


def places(poses: Array) -> Array:
    """(N, 6) [m] where cameras at poses T_wc (N, 4, 4) are, and a point before each."""
    return np.concatenate([poses[:, :3, 3], poses[:, :3, 3] + AHEAD * poses[:, :3, 2]], 1)


def unevenness(of: Array, stamps: Array) -> Array:
    """(N - 2, D) how far values (N, D) at stamps (N,) [s] are from the line between those before and after them."""
    before, span = stamps[1:-1] - stamps[:-2], stamps[2:] - stamps[:-2]
    share = np.divide(before, span, out=np.full(len(span), 0.5), where=span > 0)[:, None]
    return np.asarray(of[1:-1] - (1 - share) * of[:-2] - share * of[2:])


def usual_unevenness(poses: Array, stamps: Array) -> float:
    """[m] the median unevenness of the motion through poses T_wc (N, 4, 4) at stamps (N,) [s]."""
    uneven = np.linalg.norm(unevenness(places(poses), stamps), axis=1)
    return max(float(np.median(uneven)) if len(uneven) else 0.0, _LEAST_USUAL)


def shared(poses: Array, stamps: Array, shares: Array, T_was: Array, T_is: Array, usual: float) -> float:
    """The factor in [0, 1] on the shares (N,) of a correction by which frames at poses T_wc (N, 4, 4), stamps (N,) [s], are to be moved.

    T_was, T_is: the pose (4, 4) of one of them, which has it already, before it was corrected and after. usual: `usual_unevenness` [m].
    """
    correction = places(T_is[None]) - places(T_was[None])
    uneven, change = unevenness(places(poses), stamps) / usual, unevenness(shares[:, None] * correction, stamps) / usual
    prior = _UNSHARED**-2
    return float(np.clip((prior - (uneven * change).sum()) / (prior + (change**2).sum()), 0, 1))
