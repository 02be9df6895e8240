"""The reduced system of a bundle adjustment has the solution and the covariance of the whole one."""

import numpy as np
import pytest
from numpy.typing import NDArray

from helpers.point_problem import CAMERA, perturbed, true_problem
from idfslam.adjustment.bundle_adjustment import Problem
from idfslam.adjustment.camera_model import NAMES, CameraModel
from idfslam.adjustment.observations import Array
from idfslam.adjustment.residuals import linearise
from idfslam.adjustment.schur_complement import NormalEquations, ReducedSystem

K, P = 4, len(NAMES)


@pytest.fixture(scope="module")
def problem() -> Problem:
    return perturbed(true_problem(CameraModel.as_stated(CAMERA), keyframes=K, landmarks=40))


@pytest.fixture(scope="module")
def dense(problem: Problem) -> tuple[Array, Array]:
    """The whole Jacobian (3 N, 6 K + P + 3 L) and the residuals (3 N,)."""
    L = len(problem.points)
    at = linearise(problem.model, problem.poses, problem.points, problem.seen)
    J = np.zeros((len(problem.seen), 3, 6 * K + P + 3 * L))
    for n, (k, l) in enumerate(zip(problem.seen.keyframe, problem.seen.landmark)):
        J[n, :, 6 * k : 6 * k + 6] = at.by_pose[n]
        J[n, :, 6 * K : 6 * K + P] = at.by_values[n]
        J[n, :, 6 * K + P + 3 * l : 6 * K + P + 3 * l + 3] = at.by_point[n]
    return J.reshape(-1, J.shape[2]), at.residuals.ravel()


def unknowns(problem: Problem) -> NDArray[np.bool_]:
    """(6 K + P,) those that are estimated."""
    return np.concatenate([np.repeat(~problem.fixed, 6), problem.estimated])


def equations(problem: Problem) -> NormalEquations:
    at = linearise(problem.model, problem.poses, problem.points, problem.seen)
    return NormalEquations.of(at, np.ones((len(problem.seen), 3)), problem.seen, K, len(problem.points))


def test_solution_of_the_dense_system(problem: Problem, dense: tuple[Array, Array]) -> None:
    (J, r), L = dense, len(problem.points)
    free = np.concatenate([unknowns(problem), np.ones(3 * L, bool)])
    information = np.concatenate([np.full(6 * K + P, 2.0), np.zeros(3 * L)])
    H = J.T @ J + np.diag(information)
    expected = np.zeros(len(H))
    expected[free] = np.linalg.solve(H[np.ix_(free, free)], -(J.T @ r)[free])
    poses, values, points = ReducedSystem(equations(problem), unknowns(problem), information[: 6 * K + P]).solve(np.zeros(6 * K + P))
    found = np.concatenate([poses.ravel(), values, points.ravel()])
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    assert np.abs(poses[0]).max() == 0


def test_covariance_of_the_dense_system(problem: Problem, dense: tuple[Array, Array]) -> None:
    (J, _), L = dense, len(problem.points)
    free = np.concatenate([unknowns(problem), np.ones(3 * L, bool)])
    information = np.full(6 * K + P, 2.0)
    H = (J.T @ J + np.diag(np.concatenate([information, np.zeros(3 * L)])))[np.ix_(free, free)]
    expected = np.zeros((len(free), len(free)))
    expected[np.ix_(free, free)] = np.linalg.inv(H)
    asked = np.array([0, 7, 11, 6 * K, 6 * K + 3, 6 * K + 6])  # the first of a fixed pose, the last of a value that is not estimated
    found = ReducedSystem(equations(problem), unknowns(problem), information).covariance(asked)
    np.testing.assert_allclose(found, expected[np.ix_(asked, asked)], rtol=1e-6, atol=1e-15)
    assert found[0].tolist() == [0.0] * 6
