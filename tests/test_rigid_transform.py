"""Which matrices count as rigid transforms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from idfslam.geometry.rigid_transform import is_rigid, rotation_error


def test_rigid_within_the_tolerance() -> None:
    T = np.tile(np.eye(4), (5, 1, 1))
    T[1, :3, :3] = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    T[2, :3, :3] *= 1.004  # R^T R = 1.008016 I
    T[3, 2, 2] = -1  # a reflection
    T[4, 3, 3] = 1.001
    assert rotation_error(T) == pytest.approx([0, 0, 0.008016, 0, 0])
    assert is_rigid(T, tolerance=1e-2).tolist() == [True, True, True, False, False]
    assert is_rigid(T, tolerance=1e-3).tolist() == [True, True, False, False, False]
