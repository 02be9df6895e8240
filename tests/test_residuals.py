"""Residuals of landmarks: known values, and derivatives against numerical ones."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.point_problem import CAMERA, PIXEL, true_problem, values
from idfslam.adjustment.bundle_adjustment import Problem, exp
from idfslam.adjustment.camera_model import NAMES, CameraModel
from idfslam.adjustment.observations import Array, Observations, determined
from idfslam.adjustment.residuals import linearise, residuals

MODEL = CameraModel(CAMERA, values(focal=0.02, aspect=0.001, cx=0.01, cy=-0.01, k1=0.05, k2=-0.03, range=0.01, across=0.002, along2=0.003))
STEP = 1e-6


@pytest.fixture(scope="module")
def problem() -> Problem:
    return true_problem(MODEL, keyframes=3, landmarks=20)


def test_known_residuals() -> None:
    """A point 2 m ahead and 0.1 m to the right: 290 * 0.05 + 158 = 172.5 px."""
    uv, root, flat = np.array([[170.5, 122.0]]), np.eye(2)[None] / PIXEL, np.zeros((1, 2))
    sighting = Observations(np.array([0]), np.array([0]), uv, root, np.array([1.98]), np.array([0.01]), flat)
    found = residuals(CameraModel.as_stated(CAMERA), np.eye(4)[None], np.array([[0.1, 0.0, 2.0]]), sighting)
    np.testing.assert_allclose(found, [[2 / PIXEL, -1 / PIXEL, 2.0]], atol=1e-9)


def test_derivatives_by_poses(problem: Problem) -> None:
    at = linearise(MODEL, problem.poses, problem.points, problem.seen)
    for axis in range(6):
        xi = STEP * np.eye(6)[axis] * np.ones((3, 1))
        ahead, behind = (residuals(MODEL, problem.poses @ exp(sign * xi), problem.points, problem.seen) for sign in (1, -1))
        np.testing.assert_allclose(at.by_pose[:, :, axis], (ahead - behind) / (2 * STEP), rtol=1e-5, atol=1e-3)


def test_derivatives_by_points(problem: Problem) -> None:
    at = linearise(MODEL, problem.poses, problem.points, problem.seen)
    for axis in range(3):
        step = STEP * np.eye(3)[axis]
        ahead, behind = (residuals(MODEL, problem.poses, problem.points + sign * step, problem.seen) for sign in (1, -1))
        np.testing.assert_allclose(at.by_point[:, :, axis], (ahead - behind) / (2 * STEP), rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_by_the_camera(problem: Problem, name: str) -> None:
    i = NAMES.index(name)

    def off(sign: int) -> Array:
        moved = CameraModel(CAMERA, MODEL.values + sign * STEP * np.eye(len(NAMES))[i])
        return residuals(moved, problem.poses, problem.points, problem.seen)

    at = linearise(MODEL, problem.poses, problem.points, problem.seen)
    np.testing.assert_allclose(at.by_values[:, :, i], (off(1) - off(-1)) / (2 * STEP), rtol=1e-5, atol=1e-3)


def test_a_point_behind_the_camera_has_infinite_residuals(problem: Problem) -> None:
    points = problem.points - [0.0, 0.0, 20.0]
    assert np.isinf(residuals(MODEL, problem.poses, points, problem.seen)).all()


def test_a_landmark_needs_two_views_and_three_measurements() -> None:
    keyframe, landmark = np.array([0, 1, 0, 0, 1]), np.array([0, 0, 1, 2, 2])
    uv, root = np.zeros((5, 2)), np.tile(np.eye(2), (5, 1, 1))
    seen = Observations(keyframe, landmark, uv, root, np.array([1.0, 0.0, 1.0, 0.0, 0.0]), np.ones(5), uv)
    points, kept = determined(np.array([[0.0, 0, 1], [0, 0, 2], [0, 0, 3]]), seen)
    assert points.tolist() == [[0, 0, 1]]
    assert kept.landmark.tolist() == [0, 0]
    assert len(replace(kept)) == 2
