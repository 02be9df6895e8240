"""NEES and reliability of samples that are drawn from a known covariance."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from idfslam.evaluation.consistency import MotionErrors, reliability, share_inside
from idfslam.evaluation.doubt import ReportedFrames
from idfslam.evaluation.plots import plot_reliability
from idfslam.frame import Status

FRAMES, EVERY = 4000, 10
SIGMAS = np.array([0.01, 0.02, 0.03, 0.004, 0.006, 0.002])  # [m, rad]


def covariance(generator: np.random.Generator) -> np.ndarray:
    """With correlations between all directions."""
    mixing = np.linalg.qr(generator.normal(size=(6, 6)))[0] * 0.3 + np.eye(6)
    root = mixing * SIGMAS
    return np.asarray(root @ root.T)


def walk(generator: np.random.Generator) -> np.ndarray:
    """(N, 4, 4) true poses: up to 30 cm and 10 degrees from keyframe to keyframe."""
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, :3, 3] = np.cumsum(generator.uniform(-0.05, 0.05, (FRAMES, 3)), 0)
    poses[:, :3, :3] = Rotation.from_rotvec(0.02 * np.cumsum(generator.normal(size=(FRAMES, 3)), 0)).as_matrix()
    return poses


def measured(scale: float = 1.0, *, doubtful: slice = slice(0)) -> tuple[ReportedFrames, np.ndarray]:
    """Poses with errors of a covariance `scale` times as large as is told, in a world that is turned against the truth's."""
    generator = np.random.default_rng(0)
    truth, P = walk(generator), covariance(generator)
    errors = generator.multivariate_normal(np.zeros(6), P * scale, FRAMES)
    errors[0] = 0  # the first keyframe defines the world
    estimate = truth.copy()
    estimate[:, :3, 3] -= errors[:, :3]
    estimate[:, :3, :3] = Rotation.from_rotvec(-errors[:, 3:]).as_matrix() @ truth[:, :3, :3]
    other = np.eye(4)
    other[:3, :3], other[:3, 3] = Rotation.from_rotvec([0.4, -1.0, 0.3]).as_matrix(), [1, 2, 3]
    statuses = [Status.OK] * FRAMES
    statuses[doubtful] = [Status.DOUBTFUL] * len(statuses[doubtful])
    covariances = np.tile(P, (FRAMES, 1, 1))
    covariances[0] = np.nan
    return ReportedFrames(np.arange(FRAMES) / 30, estimate, statuses, np.arange(FRAMES) % EVERY == 0, covariances), other @ truth


def test_errors_of_the_told_covariance_have_a_nees_of_one() -> None:
    errors = MotionErrors.of(*measured())
    assert len(errors.errors) == FRAMES - 1
    nees = errors.nees()
    assert 0.9 < nees.mean() < 1.1
    assert share_inside(nees) == pytest.approx(0.95, abs=0.015)
    predicted, actual = errors.sigmas, errors.sizes
    assert np.sqrt((actual**2).mean(0)) == pytest.approx(np.sqrt((predicted**2).mean(0)), rel=0.06)


@pytest.mark.parametrize("scale", [0.25, 4.0])
def test_errors_that_are_larger_or_smaller_than_told(scale: float) -> None:
    assert MotionErrors.of(*measured(scale)).nees().mean() == pytest.approx(scale, rel=0.1)


def test_one_error_by_hand() -> None:
    """The keyframe is right; the frame's estimate lies 2 cm beside the truth and is turned by 0.1 rad."""
    truth = np.tile(np.eye(4), (3, 1, 1))
    estimate = truth.copy()
    estimate[1, 0, 3] = -0.02
    estimate[1, :3, :3] = Rotation.from_rotvec([0, 0, -0.1]).as_matrix()
    covariances = np.stack([np.full((6, 6), np.nan), np.diag([1e-4] * 3 + [1e-2] * 3), np.full((6, 6), np.nan)])
    run = ReportedFrames(np.arange(3) / 30, estimate, [Status.OK, Status.DOUBTFUL, Status.OK], np.array([True, False, False]), covariances)
    errors = MotionErrors.of(run, truth)
    np.testing.assert_allclose(errors.errors, [[0.02, 0, 0, 0, 0, 0.1]], atol=1e-12)
    np.testing.assert_allclose(errors.nees(), [(4 + 1) / 6])
    np.testing.assert_allclose(errors.sigmas, [[3**0.5 * 0.01, 3**0.5 * 0.1]])
    assert errors.trusted.tolist() == [False]


def test_a_keyframe_that_is_turned_moves_the_frames_by_the_lever() -> None:
    """1 m away from a keyframe with a turn of 0.01 rad about z, a frame lies 1 cm beside."""
    truth = np.tile(np.eye(4), (2, 1, 1))
    truth[1, 0, 3] = 1.0
    covariances = np.stack([np.diag([0, 0, 0, 0, 0, 1e-4]), np.diag([1e-8] * 6)])
    run = ReportedFrames(np.arange(2) / 30, truth.copy(), [Status.OK] * 2, np.array([True, False]), covariances)
    P = MotionErrors.of(run, truth).covariances[0]
    np.testing.assert_allclose(P[1, 1], 1e-4 + 1e-8)
    np.testing.assert_allclose([P[5, 5], P[0, 0], P[2, 2]], [1e-4 + 1e-8, 1e-8, 1e-8])
    assert P[1, 5] == pytest.approx(1e-4)  # x of the lever times the turn: error of y = e_y - e_k,y - x * e_k,z, of the turn - e_k,z


def test_frames_without_keyframe_truth_covariance_or_measured_pose_are_left_out() -> None:
    run, truth = measured()
    truth[100] = np.nan  # a keyframe
    run.covariances[205] = np.nan
    run.statuses[306] = Status.LOST  # type: ignore[index]
    loop = ReportedFrames(run.timestamps, run.T_wc, run.statuses, run.keyframes, run.covariances, corrected=(400,))
    assert len(MotionErrors.of(loop, truth).errors) == FRAMES - 1 - (1 + 10) - 1 - 1 - 1


def test_several_runs_and_trusted_frames() -> None:
    one, two = MotionErrors.of(*measured(doubtful=slice(10, 20))), MotionErrors.of(*measured(4.0))
    joined = MotionErrors.joined([one, two])
    assert len(joined.errors) == 2 * (FRAMES - 1) and joined.nees().mean() == pytest.approx(2.5, rel=0.1)
    assert len(joined.where(~joined.trusted).errors) == 10


def test_reliability_by_hand() -> None:
    predicted, actual = np.array([4.0, 1, 3, 2, 1, 2]), np.array([8.0, 1, 0, 2, 1, 2])
    bins = reliability(predicted, actual, bins=3)
    assert [(b.frames, b.predicted, b.actual) for b in bins[:2]] == [(2, 1, 1), (2, 2, 2)]
    assert (bins[2].predicted, bins[2].actual) == pytest.approx((12.5**0.5, 32**0.5))
    assert [b.frames for b in reliability(predicted[:2], actual[:2])] == [1, 1] and reliability(predicted[:0], actual[:0]) == []


def test_the_reliability_plot_is_a_picture(tmp_path: Path) -> None:
    errors = MotionErrors.of(*measured())
    plot_reliability(tmp_path / "reliability.png", errors.sigmas, errors.sizes)
    with Image.open(tmp_path / "reliability.png") as picture:
        assert picture.size == (1430, 650)
