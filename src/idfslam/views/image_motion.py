"""How far apart two views are, as one number."""

import numpy as np
from numpy.typing import NDArray

_AHEAD = 2.0  # [m] at which a shift of the camera counts as motion of the image. More: shifts count less against turns. Chosen by hand


def image_motion(T_wa: NDArray[np.float64], T_wb: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far the image moves [rad] from a camera at T_wa (4, 4) to cameras at T_wb (N, 4, 4): the turn, and the shift seen 2 m ahead."""
    cosine = (np.einsum("nij,ij->n", T_wb[:, :3, :3], T_wa[:3, :3]) - 1) / 2
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)) + np.linalg.norm(T_wb[:, :3, 3] - T_wa[:3, 3], axis=1) / _AHEAD)
