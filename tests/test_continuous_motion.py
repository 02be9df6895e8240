"""Pose and velocity of a moving camera: the prior from frame to frame, and normal equations of rows with times of their own."""

import numpy as np
import pytest
import torch
from torch import Tensor

from idfslam.alignment.continuous_motion import ContinuousMotion
from idfslam.alignment.depth_term import DepthTerm
from idfslam.alignment.gauss_newton import JointSolver, joint_step, plain_joint_step
from idfslam.alignment.image_term import ImageTerm
from idfslam.alignment.joint_equations import joint_system
from idfslam.alignment.motion import change_between, moved
from idfslam.alignment.row_moments import RowMoments
from idfslam.sensing.rectification import RowTimes

EYE = torch.eye(4, dtype=torch.float64)
VELOCITY = np.array([0.3, -0.1, 0.2, 0.5, 1.0, -0.4])


def walked(motion: ContinuousMotion, velocity: np.ndarray, frames: int, start: Tensor = EYE) -> Tensor:
    """Feeds a motion with poses of constant velocity at 30 Hz; returns the last pose."""
    T = start
    for i in range(frames):
        T = moved(start, torch.from_numpy(velocity * i / 30))
        motion.accept_pose(i / 30, T, motion.predict(i / 30, T))
    return T


def test_a_steady_motion_is_learnt_and_predicted() -> None:
    motion = ContinuousMotion()
    T = walked(motion, VELOCITY, 30)
    np.testing.assert_allclose(motion.velocity, VELOCITY, rtol=0.02, atol=0.01)
    prior = motion.predict(30 / 30, EYE)
    ahead = change_between(T, prior.T_wc).numpy()
    np.testing.assert_allclose(ahead, VELOCITY / 30, rtol=0.03, atol=3e-4)


def test_the_next_frame_improves_a_velocity() -> None:
    """The pose swings at 2 Hz. A velocity that was estimated from the frames before lags; the smoothed one is twice as exact."""
    motion, errors = ContinuousMotion(), []
    for i in range(60):
        angle = torch.tensor([0, 0, 0, 0, np.sin(4 * np.pi * i / 30) / 4, 0], dtype=torch.float64)
        before, T = motion.velocity, moved(EYE, angle)
        smoothed_velocity = motion.accept_pose(i / 30, T, motion.predict(i / 30, EYE))
        true = np.pi * np.cos(4 * np.pi * (i - 1) / 30)
        if i > 20:
            assert smoothed_velocity is not None
            errors.append((before[4] - true, smoothed_velocity[0][4] - true))
    filtered, smoothed = np.sqrt((np.array(errors) ** 2).mean(0))
    assert 0.3 < filtered < 0.6 and smoothed < filtered / 2


@pytest.mark.parametrize(("hertz", "continuous"), [(1.0, True), (4.0, True), (9.0, False)])
def test_a_hand_that_turns_back_from_frame_to_frame_has_no_velocity(hertz: float, continuous: bool) -> None:
    """Up to a sixth of the frame rate (5 Hz) constant velocity is nearer to the next pose of a swing than the last pose is."""
    motion = ContinuousMotion()
    for i in range(40):
        T = moved(EYE, torch.tensor([0, 0, 0, 0, 0.02 * np.sin(2 * np.pi * hertz * i / 30), 0], dtype=torch.float64))
        motion.accept_pose(i / 30, T, motion.predict(i / 30, EYE))
    assert motion.is_continuous == continuous


def test_photographs_have_no_velocity() -> None:
    """Steps of 17 degrees in any direction, stamped as a video's. A restored motion knows as much."""
    motion, T, generator = ContinuousMotion(), EYE, torch.Generator().manual_seed(0)
    for i in range(20):
        turn = torch.randn(3, generator=generator, dtype=torch.float64)
        T = moved(T, torch.cat([torch.zeros(3, dtype=torch.float64), 0.3 * turn / turn.norm()]))
        motion.accept_pose(i / 30, T, motion.predict(i / 30, EYE))
    restored = ContinuousMotion()
    restored.restore(motion.state())
    assert not motion.is_continuous and not restored.is_continuous
    assert not motion.is_of_a_hand and not restored.is_of_a_hand


def test_a_missing_frame_takes_two_intervals() -> None:
    motion = ContinuousMotion()
    T = walked(motion, VELOCITY, 30)
    ahead = change_between(T, motion.predict(31 / 30, EYE).T_wc).numpy()
    np.testing.assert_allclose(ahead, 2 * VELOCITY / 30, rtol=0.05, atol=1e-3)


def test_jitter_of_the_stamps_is_not_motion() -> None:
    motion = ContinuousMotion()
    T = walked(motion, VELOCITY, 30)
    ahead = change_between(T, motion.predict(30 / 30 + 0.006, EYE).T_wc).numpy()
    np.testing.assert_allclose(ahead, VELOCITY / 30, rtol=0.03, atol=3e-4)


def test_sums_are_carried_to_another_pose() -> None:
    """Residuals that are linear in the pose: sums taken elsewhere and carried back are those taken here."""
    generator = torch.Generator().manual_seed(5)
    J = torch.randn(50, 6, generator=generator, dtype=torch.float64)
    r, rows = torch.randn(50, generator=generator, dtype=torch.float64), torch.rand(50, generator=generator, dtype=torch.float64) - 0.5
    change, w = torch.randn(6, generator=generator, dtype=torch.float64), torch.ones(50, dtype=torch.float64)
    here, there = RowMoments.of(J, w, r, rows), RowMoments.of(J, w, r + J @ change, rows)
    np.testing.assert_allclose(there.carried(change.numpy()).b, here.b, atol=1e-9)


def test_a_moved_graph_moves_the_motion() -> None:
    motion = ContinuousMotion()
    T = walked(motion, VELOCITY, 30)
    turned = torch.eye(4, dtype=torch.float64)
    turned[:3, :3] = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # a quarter turn about z
    turned[:3, 3] = torch.tensor([1.0, 2, 3])
    before, velocity = motion.predict(1.0, EYE).T_wc, motion.velocity
    motion.follow(turned @ T)
    torch.testing.assert_close(motion.predict(1.0, EYE).T_wc, turned @ before)
    assert motion.velocity.tolist() == pytest.approx([-velocity[1], velocity[0], velocity[2], -velocity[4], velocity[3], velocity[5]])


def test_stopping_forgets_the_motion() -> None:
    motion = ContinuousMotion()
    walked(motion, VELOCITY, 10)
    motion.stop()
    assert not motion.velocity.any()
    assert torch.equal(motion.predict(1.0, EYE).T_wc, EYE)


def test_state_and_restore() -> None:
    motion, again = ContinuousMotion(), ContinuousMotion()
    walked(motion, VELOCITY, 10)
    again.restore(motion.state())
    one, other = (m.predict(10 / 30, EYE) for m in (motion, again))
    assert torch.equal(one.T_wc, other.T_wc)
    assert np.array_equal(one.velocity, other.velocity) and np.array_equal(one.information, other.information)


def rows_of(J: Tensor, rows: Tensor, change: np.ndarray, velocity: np.ndarray, times: Tensor) -> RowMoments:
    """The sums of residuals that a pose off by `change` and a velocity off by `velocity` have, at times (N,) [s]."""
    r = J @ torch.from_numpy(change) + times * (J @ torch.from_numpy(velocity))
    return RowMoments.of(J, torch.ones(len(J), dtype=torch.float64), r, rows)


@pytest.fixture
def jacobians() -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    return torch.randn(400, 6, generator=generator, dtype=torch.float64), torch.rand(400, generator=generator, dtype=torch.float64) - 0.5


def test_rows_tell_pose_and_velocity(jacobians: tuple[Tensor, Tensor]) -> None:
    J, rows = jacobians
    times, change = RowTimes(0.026, 0.03, -0.012), np.array([0.01, -0.02, 0.005, 0.01, 0.02, -0.01])
    depth = rows_of(J[:200], rows[:200], change, VELOCITY, -0.012 + 0.03 * rows[:200])
    images = rows_of(J[200:], rows[200:], change, VELOCITY, 0.026 * rows[200:])
    H, b = joint_system(depth, images, times)
    found = np.linalg.solve(H, -b)
    np.testing.assert_allclose(found[:6], change, atol=1e-9)
    np.testing.assert_allclose(found[6:], VELOCITY, atol=1e-7)


def test_a_step_follows_the_rows_where_the_prior_is_weak(jacobians: tuple[Tensor, Tensor]) -> None:
    J, rows = jacobians
    times = RowTimes(0.026)
    images = rows_of(J, rows, np.zeros(6), -VELOCITY, 0.026 * rows)
    T = EYE.clone()
    solver = JointSolver(T, ContinuousMotion().predict(0.0, EYE), times, depth_noise=1e-4)
    solver.step(DepthTerm.absent(weight=1.0, radius=1.0, moments=True), ImageTerm(images, 0.01, 1.0))
    estimate = solver.estimate(DepthTerm.absent(weight=1.0, radius=1.0, moments=True), ImageTerm(images, 0.01, 1.0))
    assert np.abs(change_between(EYE, T).numpy()).max() < 2e-3
    assert np.dot(estimate.velocity, VELOCITY) > 0.05 * np.dot(VELOCITY, VELOCITY)
    assert (np.linalg.eigvalsh(estimate.covariance) > 0).all()


def test_a_sure_reference_lets_the_rows_decide(jacobians: tuple[Tensor, Tensor]) -> None:
    J, rows = jacobians
    times = RowTimes(0.026)
    images = rows_of(J, rows, np.zeros(6), -VELOCITY, 0.026 * rows)
    found = []
    for error in (1e-4, 1.0):  # [m/s], [rad/s]
        prior = ContinuousMotion().predict(0.0, EYE).against([error**2 * np.eye(6), error**2 * np.eye(6)])
        solver = JointSolver(EYE.clone(), prior, times, depth_noise=1e-4)
        solver.step(DepthTerm.absent(weight=1.0, radius=1.0, moments=True), ImageTerm(images, 0.01, 1.0))
        found.append(float(np.dot(solver.velocity, VELOCITY) / np.dot(VELOCITY, VELOCITY)))
    assert found[0] > 0.9  # the distortion is the frame's own
    assert found[1] < 0.75  # the distortion may be the references'


def test_the_velocity_between_the_first_two_poses() -> None:
    motion = ContinuousMotion()
    motion.start(EYE, moved(EYE, torch.from_numpy(VELOCITY / 30)), 1 / 30)
    np.testing.assert_allclose(motion.velocity, VELOCITY, atol=1e-9)
    assert np.sqrt(np.diag(motion.velocity_covariance)) == pytest.approx(30 * 2**0.5 * 2e-3)  # both poses are exact to 2 mm, 2 mrad


def test_compiled_joint_step(jacobians: tuple[Tensor, Tensor]) -> None:
    J, rows = jacobians
    times, change = RowTimes(0.026, 0.03, -0.012), np.array([0.01, -0.02, 0.005, 0.01, 0.02, -0.01])
    depth = rows_of(J[:200], rows[:200], change, VELOCITY, -0.012 + 0.03 * rows[:200])
    images = rows_of(J[200:], rows[200:], change, VELOCITY, 0.026 * rows[200:])
    information = ContinuousMotion().predict(0.0, EYE).with_reference_error
    from_prior = np.random.default_rng(0).normal(0, 0.05, 18)
    found = joint_step(depth, images, times, information, 3.0, from_prior)
    np.testing.assert_allclose(found, plain_joint_step(depth, images, times, information, 3.0, from_prior), rtol=1e-7, atol=1e-10)
