"""Depth of an unknown moment: its displacement is eliminated exactly, and does not draw the pose of a moving camera."""

import numpy as np
import torch

from helpers.three_walls import CORNER, EYE, aligner, error, pose, taught, view, with_depth
from idfslam.alignment.depth_term import DepthTerm
from idfslam.alignment.motion import change_between, moved
from idfslam.alignment.row_moments import RowMoments
from idfslam.alignment.unknown_delay import DisplacedDepth

VELOCITY = np.array([0.3, -0.1, 0.2, 0.5, 1.0, -0.4])  # [m/s], [rad/s]
INTERVAL = 1 / 30  # [s]


def test_eliminating_the_displacement_is_solving_for_it() -> None:
    """Twelve unknowns, with a prior on the last six: the first six are those of the equations without them."""
    rng, scale, covariance = np.random.default_rng(0), 2.0, np.diag([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    J, r = rng.standard_normal((30, 6)), rng.standard_normal(30)
    others = np.eye(6)  # what images know of the pose
    displaced = DisplacedDepth(covariance, scale)
    freed = displaced.marginalised(DepthTerm(RowMoments((J.T @ J)[None], (-J.T @ r)[None]), 30.0, 1.0, 0.01, 1.0, 2.0))
    A = np.concatenate([J, J], 1)
    H, b = A.T @ A, -A.T @ r
    H[:6, :6] += others
    H[6:, 6:] += np.linalg.inv(scale * covariance)
    found = np.linalg.solve(freed.sums.H[0] + others, freed.sums.b[0])
    np.testing.assert_allclose(found, np.linalg.solve(H, b)[:6], rtol=1e-9)
    at_this_pose = np.linalg.solve(H[6:, 6:], b[6:])
    np.testing.assert_allclose(displaced.displacement, at_this_pose, rtol=1e-9)
    np.testing.assert_allclose(change_between(EYE, displaced.pose(EYE)).numpy(), at_this_pose, atol=1e-9)


def test_late_depth_does_not_draw_the_pose() -> None:
    """Depth is a frame late, 1.2 cm and 2.3 degrees away, while the camera speeds up. The images see the truth."""
    truth = pose(0.03, 0.02, 0.02, 0.01, 0.02, 0.0)
    T_depth = moved(truth, torch.from_numpy(-INTERVAL * VELOCITY))
    late = with_depth(view(CORNER, truth), view(CORNER, T_depth).depth)
    judge, references, guess = aligner(taught(CORNER)), [view(CORNER, EYE)], truth @ pose(0.005, 0, 0, 0, 0.005, 0)
    drawn = error(judge.align(late, guess, references).T_wc, truth)
    freed = error(judge.align(late, guess, references, displaced_by=0.015**2 * np.diag(np.repeat([0.25, 1.0], 3))).T_wc, truth)
    assert freed[0] < 0.5 * drawn[0] and freed[1] < 0.5 * drawn[1], (drawn, freed)
