"""The blind zone: holes that a body makes which is nearer than the sensor reads, from when it is read beside them on."""

import numpy as np

from idfslam.segmentation.blind_zone import blind
from idfslam.segmentation.constants import NEVER

NONE = np.full((20, 30), NEVER, np.int32)


def passing() -> tuple[np.ndarray, np.ndarray]:
    """Depth (20, 30) [m] of a wall, a body's rim that is read in columns 10 to 11, and what is nearer than that to the right of it."""
    depth, moving = np.full((20, 30), 3.0, np.float32), np.zeros((20, 30), np.bool_)
    depth[:, 10:12], depth[:, 12:] = 0.6, 0.0
    moving[:, 10:12] = True
    return depth, moving


def test_a_hole_beside_a_near_body_shows_it() -> None:
    depth, moving = passing()
    depth[3:5, 2:4] = 0.0  # a hole in the wall
    age = blind(depth, moving, NONE)
    assert (age[:, 12:] == 0).all()
    assert (age[:, :12] == NEVER).all()


def test_a_hole_beside_a_far_body_or_beside_nothing_that_moves_is_a_hole() -> None:
    depth, moving = passing()
    assert (blind(depth, np.zeros_like(moving), NONE) == NEVER).all()
    depth[:, 10:12] = 1.5
    assert (blind(depth, moving, NONE) == NEVER).all()


def test_a_hole_goes_on_without_a_rim_and_grows_older() -> None:
    depth, moving = passing()
    before = blind(depth, moving, NONE)
    depth[:, 5:12] = 0.0
    for k in range(1, 4):
        before = blind(depth, np.zeros_like(moving), before)
        assert (before[:, 5:] == k).all()
        assert (before[:, :5] == NEVER).all()
    depth[:, :] = 3.0
    assert (blind(depth, moving, before) == NEVER).all()
