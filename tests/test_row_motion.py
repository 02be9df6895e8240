"""Landmarks that are seen at the times of rows: known places, derivatives against numerical ones, velocities that are found."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.point_problem import CAMERA, perturbed, true_problem, values
from idfslam.adjustment.bundle_adjustment import Problem, adjust, exp, in_motion
from idfslam.adjustment.camera_model import NAMES, CameraModel
from idfslam.adjustment.observations import Array
from idfslam.adjustment.residuals import camera_points, linearise, residuals
from idfslam.adjustment.row_motion import KeyframeMotion, RowMotion, Velocities, displaced
from idfslam.geometry import se3
from idfslam.sensing.rectification import Rectification, RowTimes

TIMES = RowTimes(0.03, 0.026, -0.012)
MODEL = CameraModel(CAMERA, values(focal=0.02, cx=0.01, k1=0.05))
STEP = 1e-6


def motions(keyframes: int, wrong: float, seed: int = 0) -> tuple[list[KeyframeMotion], Array]:
    """Shaken keyframes, rectified with velocities that are wrong by a normal distribution [m/s, rad/s]; and their true velocities."""
    rng = np.random.default_rng(seed)
    true = rng.standard_normal((keyframes, 6)) * ([0.3] * 3 + [1.0] * 3)
    acceleration = rng.standard_normal((keyframes, 6)) * ([2.0] * 3 + [20.0] * 3)
    known = true + wrong * rng.standard_normal((keyframes, 6))
    covariance = np.eye(6) * max(wrong, 1e-3) ** 2
    return [KeyframeMotion(TIMES, v, covariance, a, Rectification(TIMES, v)) for v, a in zip(known, acceleration)], true


def moving(problem: Problem, wrong: float) -> tuple[Problem, Array]:
    """The problem with images that a moving camera with true velocities (K, 6) took, rectified with wrong ones."""
    found, true = motions(len(problem.poses), wrong)
    problem = in_motion(problem, found)
    seen, rows = problem.seen, problem.seen.rows
    assert rows is not None
    p = camera_points(problem.poses, problem.points, seen)
    places = [displaced(p, rows.seconds[:, i, None] * true[seen.keyframe] + rows.given[:, i])[0] for i in range(2)]
    bent = problem.model.project(places[0])[0] - problem.model.project(p)[0]
    return replace(problem, seen=replace(seen, uv=seen.uv + bent, reading=seen.reading + places[1][:, 2] - p[:, 2])), true


def with_inexact(problem: Problem, sigmas: Array, late: Array) -> Problem:
    """The problem of images whose rows were exposed `late` (3,) [s] by their times: what is known of these has deviations `sigmas` (3,)."""
    found, true = motions(len(problem.poses), 0.1)
    problem = in_motion(problem, found, sigmas=sigmas[None])
    seen, rows = problem.seen, problem.seen.rows
    assert rows is not None
    p = camera_points(problem.poses, problem.points, seen)
    _, moved, _ = rows.displacements(true[seen.keyframe], late[sigmas > 0])
    places = [displaced(p, moved[:, i])[0] for i in range(2)]
    bent = problem.model.project(places[0])[0] - problem.model.project(p)[0]
    return replace(problem, seen=replace(seen, uv=seen.uv + bent, reading=seen.reading + places[1][:, 2] - p[:, 2]))


@pytest.fixture(scope="module")
def problem() -> Problem:
    found = moving(true_problem(MODEL, keyframes=3, landmarks=20), 0.1)[0]
    rng = np.random.default_rng(2)
    return replace(found, seen=replace(found.seen, slope=0.02 * rng.standard_normal(found.seen.slope.shape)))


def off(problem: Problem) -> Array:
    assert problem.velocities is not None
    return residuals(problem.model, problem.poses, problem.points, problem.seen, problem.velocities.present)


def test_a_displaced_point_is_that_of_the_exponential() -> None:
    rng = np.random.default_rng(1)
    p, xi = rng.uniform(1, 3, (5, 3)), 0.02 * rng.standard_normal((5, 6))
    T = se3.exp(torch.from_numpy(-xi))
    np.testing.assert_allclose(
        displaced(p, xi)[0], se3.transform(T, torch.from_numpy(p)[:, None])[:, 0], atol=1e-4
    )  # of 3 m: less than a hundredth of a pixel


@pytest.mark.parametrize("axis", range(6))
def test_derivatives_by_poses_and_velocities(problem: Problem, axis: int) -> None:
    assert problem.velocities is not None
    v = problem.velocities.present
    at = linearise(problem.model, problem.poses, problem.points, problem.seen, v)
    xi = STEP * np.eye(6)[axis] * np.ones((len(v), 1))
    ahead, behind = (off(replace(problem, poses=problem.poses @ exp(sign * xi))) for sign in (1, -1))
    np.testing.assert_allclose(at.by_pose[:, :, axis], (ahead - behind) / (2 * STEP), rtol=1e-5, atol=1e-3)
    ahead, behind = (off(replace(problem, velocities=replace(problem.velocities, present=v + sign * xi))) for sign in (1, -1))
    np.testing.assert_allclose(at.by_pose[:, :, 6 + axis], (ahead - behind) / (2 * STEP), rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("axis", range(3))
def test_derivatives_by_points(problem: Problem, axis: int) -> None:
    assert problem.velocities is not None
    at = linearise(problem.model, problem.poses, problem.points, problem.seen, problem.velocities.present)
    ahead, behind = (off(replace(problem, points=problem.points + sign * STEP * np.eye(3)[axis])) for sign in (1, -1))
    np.testing.assert_allclose(at.by_point[:, :, axis], (ahead - behind) / (2 * STEP), rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("time", range(3))
def test_derivatives_by_times(time: int) -> None:
    inexact = with_inexact(true_problem(MODEL, keyframes=3, landmarks=20), np.full(3, 0.01), np.array([0.002, -0.001, 0.003]))
    assert inexact.velocities is not None
    still = inexact.model, inexact.poses, inexact.points, inexact.seen, inexact.velocities.present
    step, present = STEP * np.eye(3)[time], np.array([0.004, 0.002, -0.003])
    by_time = linearise(*still, present).by_values[:, :, len(NAMES) + time]
    np.testing.assert_allclose(
        by_time, (residuals(*still, present + step) - residuals(*still, present - step)) / (2 * STEP), rtol=1e-5, atol=1e-2
    )
    assert np.abs(by_time).max() > 50


def test_a_right_velocity_changes_no_residual() -> None:
    """An image that was rectified with the true velocity shows all landmarks at the time stamp."""
    still = true_problem(CameraModel.as_stated(CAMERA), keyframes=3, landmarks=30)
    found = [replace(motion, acceleration=np.zeros(6)) for motion in motions(3, 0.0)[0]]
    plain = residuals(still.model, still.poses, still.points, still.seen)
    np.testing.assert_allclose(off(in_motion(still, found)), plain, atol=1e-9)


def test_the_first_row_is_seen_half_a_read_out_before() -> None:
    """Turned at 1 rad/s about its vertical axis, 15 ms before, a camera saw what was ahead 15 mrad to the right of it: at 0.03 m of 2 m."""
    motion = KeyframeMotion(RowTimes(0.03, 0.0, 0.004), np.array([0, 0, 0, 0, 1.0, 0]), np.eye(6), np.zeros(6), None)
    rows: RowMotion = motion.rows(np.array([[0.0, -5.0, 2.0], [0.0, 5.0, 2.0]]), CAMERA)
    assert rows.seconds.tolist() == [[-0.015, 0.004], [0.015, 0.004]]
    assert not rows.given.any()
    seen = displaced(np.array([[0.0, 0.0, 2.0]]), rows.seconds[:1, :1] * motion.velocity)[0]
    np.testing.assert_allclose(seen, [[0.03, 0.0, 2.0]], atol=3e-4)


def test_the_adjustment_finds_poses_and_velocities() -> None:
    """Velocities that are off by 0.1 m/s and 0.1 rad/s in each direction bend the poses of an adjustment that does not know of them."""
    true = replace(true_problem(CameraModel.as_stated(CAMERA), landmarks=300, noise=0.5), estimated=np.zeros(len(NAMES), bool))
    bent, velocities = moving(true, 0.1)
    assert bent.velocities is not None
    start = perturbed(bent)
    found = adjust(start).problem
    blind = adjust(replace(start, velocities=None, seen=replace(start.seen, rows=None))).problem
    assert found.velocities is not None

    def shifts(poses: Array) -> Array:
        return np.asarray(np.linalg.norm((poses - true.poses)[1:, :3, 3], axis=1))

    assert shifts(blind.poses).mean() > 3 * shifts(found.poses).mean()
    assert shifts(found.poses).mean() < 0.002
    before, after = (np.abs(v - velocities)[:, 3:].mean() for v in (bent.velocities.present, found.velocities.present))
    assert before == pytest.approx(0.08, abs=0.02)
    assert after < 0.03


def test_times_that_are_not_exact_are_adjusted() -> None:
    """A read-out of colour that is 4 ms longer than was taken, within its deviation of 5 ms; that of depth is exact."""
    late = np.array([0.004, 0.0, -0.003])
    true = true_problem(CameraModel.as_stated(CAMERA), landmarks=300, noise=0.5)
    bent = with_inexact(replace(true, estimated=true.estimated & (np.arange(len(NAMES)) < 4)), np.array([0.005, 0.0, 0.005]), late)
    found = adjust(perturbed(bent))
    np.testing.assert_allclose(found.problem.times.present, late[[0, 2]], atol=5e-4)
    assert found.problem.times.cost == pytest.approx(1.0, abs=0.3)


def test_covariances_with_velocities_are_honest() -> None:
    squares = []
    for seed in range(6):
        true = replace(true_problem(CameraModel.as_stated(CAMERA), landmarks=120, seed=seed), estimated=np.zeros(len(NAMES), bool))
        found = adjust(moving(true, 0.1)[0])
        for k in range(1, len(true.poses)):
            xi = se3.log(torch.from_numpy(np.linalg.inv(found.problem.poses[k]) @ true.poses[k])).numpy()
            squares.append(xi @ np.linalg.solve(found.pose_covariance(k), xi) / 6)
    assert 0.6 < np.mean(squares) < 1.6


def test_the_prior_is_what_is_known() -> None:
    found, _ = motions(2, 0.1)
    prior = Velocities.of(found)
    assert prior.cost == 0
    moved = replace(prior, present=prior.prior + 0.1)
    assert moved.cost == pytest.approx(12)
    np.testing.assert_allclose(moved.right, -0.1 / 0.1**2)
