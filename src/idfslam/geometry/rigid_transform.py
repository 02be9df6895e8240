"""Whether 4x4 matrices are rigid transforms: a rotation and a translation, nothing else."""

import numpy as np
from numpy.typing import NDArray

RIGID = 1e-2  # [1] `rotation_error` allowed in files of other programs; raised, damaged rotations pass. Ten times that of our own files:
#    published recordings round their numbers to three decimals
_LAST_ROW = 1e-6  # [1] error allowed in the last row 0 0 0 1; no file rounds it, so that a larger error means another kind of matrix


def rotation_error(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) the largest entry of |R^T R - I| of matrices (N, 4, 4); 0 for a rotation or a reflection."""
    R = T[:, :3, :3]
    error: NDArray[np.float64] = np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max((1, 2))
    return error


def is_rigid(T: NDArray[np.float64], *, tolerance: float) -> NDArray[np.bool_]:
    """(N,) whether finite matrices (N, 4, 4) are rigid transforms.

    `tolerance` bounds `rotation_error`: numbers in files are rounded. A reflection is not rigid.
    """
    last_row = np.abs(T[:, 3] - [0, 0, 0, 1]).max(-1) <= _LAST_ROW
    return np.asarray((rotation_error(T) <= tolerance) & (np.linalg.det(T[:, :3, :3]) > 0) & last_row)
