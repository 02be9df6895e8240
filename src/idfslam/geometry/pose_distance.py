"""How far apart two views are, in one number of shift and turn."""

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from idfslam.geometry import se3

AHEAD = 2.0  # [m] distance of the point whose shift measures a turn, about the depth of a room. More: turns count more. Chosen by hand


def pose_distances(T_a: NDArray[np.float64], T_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances (E,) [m] between poses (E or 1, 4, 4): the shift, plus the turn as the shift of a point 2 m in front of the camera."""
    shift = np.linalg.norm(T_b[:, :3, 3] - T_a[:, :3, 3], axis=1)
    chord = np.linalg.norm(T_b[:, :3, :3] - T_a[:, :3, :3], axis=(1, 2))
    return shift + AHEAD * 2 * np.arcsin(np.minimum(chord / 8**0.5, 1.0))  # for rotations A and B, |B - A| = sqrt(8) sin(angle / 2)


def shift_ahead(change: Tensor) -> float:
    """Bound on the shift [m] of a point `AHEAD` in front of a camera whose pose changes by `change` (4, 4), along its own axes."""
    return float(change[:3, 3].norm() + AHEAD * se3.angle(change))


def apparent_motions(T_wa: NDArray[np.float64], T_wb: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far the image moves [rad] from a camera at T_wa (4, 4) to cameras at T_wb (N, 4, 4): the turn, and the shift seen 2 m ahead."""
    return pose_distances(T_wa[None], T_wb) / AHEAD
