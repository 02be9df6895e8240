"""The normal equations of a frame's pose and velocity together, from the sums of its residuals over the rows of its images."""

import numpy as np
from numpy.typing import NDArray

from idfslam.alignment.row_moments import RowMoments
from idfslam.sensing.rectification import RowTimes

Array = NDArray[np.float64]


def joint_system(depth: RowMoments, images: RowMoments, times: RowTimes) -> tuple[Array, Array]:
    """The normal equations H (12, 12), b (12,) of pose and velocity: a residual at time s has the Jacobian (J, s J)."""
    D, C, d, i = depth.H, images.H, depth.b, images.b
    a, r, c = times.depth_delay, times.depth_readout, times.readout
    cross = a * D[0] + r * D[1] + c * C[1]
    square = a * a * D[0] + 2 * a * r * D[1] + r * r * D[2] + c * c * C[2]
    return _of_blocks(D[0] + C[0], cross, square), np.concatenate([d[0] + i[0], a * d[0] + r * d[1] + c * i[1]])


def with_reference_error(H: Array, b: Array) -> tuple[Array, Array]:
    """These with one more unknown, the references' error of velocity: (18, 18), (18,). It distorts as the velocity does."""
    both = [*range(6), *range(6, 12), *range(6, 12)]
    return H[np.ix_(both, both)], b[both]


def _of_blocks(pose: Array, cross: Array, velocity: Array) -> Array:
    """(12, 12) of pose and velocity from its blocks (6, 6). `np.block` takes ten times as long."""
    whole = np.empty((12, 12))
    whole[:6, :6], whole[:6, 6:], whole[6:, :6], whole[6:, 6:] = pose, cross, cross, velocity
    return whole
