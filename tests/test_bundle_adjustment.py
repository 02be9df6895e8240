"""Bundle adjustment: it finds what is known, says how sure it is, and leaves alone what nothing tells."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.point_problem import CAMERA, perturbed, true_problem, values
from idfslam.adjustment.bundle_adjustment import Problem, adjust
from idfslam.adjustment.camera_model import NAMES, CameraModel
from idfslam.adjustment.observations import determined
from idfslam.geometry import se3
from idfslam.graph.pose_graph import Edge, RelativePoses

TRUE = CameraModel(CAMERA, values(focal=0.03, aspect=0.001, cx=0.01, cy=-0.005, k1=0.02, range=0.005, across2=0.003))
FOCAL, CX = NAMES.index("focal"), NAMES.index("cx")


def test_exact_measurements_give_the_truth() -> None:
    problem = true_problem(TRUE, noise=0.0)
    found = adjust(perturbed(problem)).problem
    np.testing.assert_allclose(found.model.values, TRUE.values, atol=2e-5)
    np.testing.assert_allclose(found.poses, problem.poses, atol=1e-4)
    np.testing.assert_allclose(found.points, problem.points, atol=2e-4)


def test_outliers_are_left_out() -> None:
    problem = true_problem(TRUE, noise=0.3)
    rng = np.random.default_rng(5)
    wrong = rng.random(len(problem.seen)) < 0.1
    uv = problem.seen.uv + wrong[:, None] * rng.uniform(-30, 30, problem.seen.uv.shape)
    found = adjust(perturbed(replace(problem, seen=replace(problem.seen, uv=uv))))
    assert found.problem.model.values[FOCAL] == pytest.approx(0.03, abs=0.001)
    assert found.problem.model.values[CX] == pytest.approx(0.01, abs=0.001)
    assert len(found.problem.seen) < 0.93 * len(problem.seen)


@pytest.mark.parametrize("noise", [0.5, 3.0])
def test_the_noise_is_estimated(noise: float) -> None:
    assert adjust(perturbed(true_problem(TRUE, noise=noise))).noise == pytest.approx((noise, noise, 1), rel=0.08)


def test_covariances_are_honest() -> None:
    """The squared errors in units of the covariance are the number of unknowns on average, over 12 draws of the noise."""
    estimated = np.array([name != "depth_scale" for name in NAMES])
    of_values, of_poses = [], []
    for seed in range(12):
        problem = true_problem(TRUE, landmarks=120, seed=seed)
        found = adjust(perturbed(problem))
        off = (found.problem.model.values - TRUE.values)[estimated]
        of_values.append(off @ np.linalg.solve(found.values_covariance()[np.ix_(estimated, estimated)], off) / estimated.sum())
        shift = (found.problem.poses[-1, :3, :3].T @ (problem.poses[-1, :3, 3] - found.problem.poses[-1, :3, 3]))[:3]
        of_poses.append(shift @ np.linalg.solve(found.pose_covariance(len(problem.poses) - 1)[:3, :3], shift) / 3)
    assert 0.6 < np.mean(of_values) < 1.6
    assert 0.5 < np.mean(of_poses) < 1.8


def test_a_value_that_nothing_tells_keeps_its_prior() -> None:
    """One view of points with depth says nothing of the lens: any will do."""
    problem = true_problem(TRUE, noise=1.0)
    first = problem.seen[problem.seen.keyframe == 0]
    twice = replace(first[np.repeat(np.arange(len(first)), 2)], keyframe=np.tile([0, 1], len(first)))
    alone = replace(
        problem,
        model=CameraModel.as_stated(CAMERA),
        poses=np.tile(np.eye(4), (2, 1, 1)),
        seen=twice,
        fixed=np.array([True] * 2),
    )
    sigma = np.sqrt(np.diag(adjust(alone).values_covariance()))
    assert sigma[FOCAL] == pytest.approx(0.05, rel=0.01)
    assert sigma[CX] == pytest.approx(0.02, rel=0.01)


def test_two_adjustments_are_equal_to_the_bit() -> None:
    problem = perturbed(true_problem(TRUE))
    one, other = adjust(problem).problem, adjust(problem).problem
    np.testing.assert_array_equal(one.poses, other.poses)
    np.testing.assert_array_equal(one.model.values, other.model.values)


def test_no_time_no_change() -> None:
    problem = perturbed(true_problem(TRUE))
    found: Problem = adjust(problem, seconds=0.0).problem
    np.testing.assert_array_equal(found.poses, problem.poses)
    assert not adjust(problem, seconds=0.0).complete


def test_a_measured_relative_pose_holds_a_keyframe_without_landmarks() -> None:
    """The last keyframe sees no landmark: it stays where it was relative to the one before, which moves."""
    problem = perturbed(true_problem(TRUE, noise=0.3))
    last = len(problem.poses) - 1
    T = torch.from_numpy(problem.poses)
    relative = se3.inverse(T[last - 1]) @ T[last]
    edges = RelativePoses.of([Edge(last - 1, last, relative, 0.01, 0.004)])
    points, seen = determined(problem.points, problem.seen[problem.seen.keyframe != last])
    found = adjust(replace(problem, points=points, seen=seen, edges=edges))
    poses = torch.from_numpy(found.problem.poses)
    assert float((poses[last - 1] - T[last - 1]).abs().max()) > 0.005
    np.testing.assert_allclose(se3.inverse(poses[last - 1]) @ poses[last], relative, atol=1e-5)
    before, after = (np.sqrt(np.trace(found.pose_covariance(k)[:3, :3])) for k in (last - 1, last))
    assert after == pytest.approx(np.hypot(before, 0.01 * np.sqrt(3)), rel=0.2)
