"""ATE and RPE: hand-worked numbers, frames without ground truth, and agreement with evo."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idfslam.evaluation.trajectory_error import (
    Statistics,
    absolute_trajectory_error,
    first_pose_alignment,
    matched_ground_truth,
    pose_alignment,
    relative_pose_error,
)
from idfslam.geometry.trajectory import Trajectory, TrajectoryError


def at(positions: list[list[float]]) -> NDArray[np.float64]:
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, 3] = positions
    return poses


def random_walk(count: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A true trajectory, and a noisy estimate of it in another frame."""
    generator = np.random.default_rng(seed)
    truth, estimate = np.tile(np.eye(4), (2, count, 1, 1))
    turns = Rotation.from_rotvec(np.cumsum(generator.normal(0, 0.05, (count, 3)), 0))
    truth[:, :3, :3], truth[:, :3, 3] = turns.as_matrix(), np.cumsum(generator.normal(0, 0.03, (count, 3)), 0)
    estimate[:, :3, :3] = (turns * Rotation.from_rotvec(generator.normal(0, 0.01, (count, 3)))).as_matrix()
    estimate[:, :3, 3] = truth[:, :3, 3] + generator.normal(0, 0.02, (count, 3))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(random_state=seed).as_matrix(), [1, -2, 3]
    return truth, T @ estimate


def test_statistics_by_hand() -> None:
    # Of 0, 3, 3, 6: squares sum to 54, /4 = 13.5; mean 3; deviations 3, 0, 0, 3: sqrt(18/4)
    s = Statistics.of(np.array([0.0, 3.0, 3.0, 6.0]))
    assert (s.rmse, s.mean, s.median, s.max, s.std) == pytest.approx((13.5**0.5, 3, 3, 6, 4.5**0.5))


def test_ate_by_hand() -> None:
    # A square of side 2, its corners moved outwards along x and y in turns: no rigid motion repairs a symmetric widening
    square = [[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    wider = [[-1.1, -1, 0], [1.1, -1, 0], [1.1, 1, 0], [-1.1, 1, 0]]
    ate = absolute_trajectory_error(at(wider), at(square))
    assert ate.errors == pytest.approx([0.1] * 4)
    assert (ate.translation.rmse, ate.translation.std) == pytest.approx((0.1, 0))
    assert np.allclose(ate.T_gt_est, np.eye(4))


def test_rpe_by_hand() -> None:
    # The truth stands still; the estimate moves 3 cm a frame and turns 1 degree a frame about z
    truth, estimate = at([[0.0, 0, 0]] * 5), at([[0.03 * i, 0, 0] for i in range(5)])
    one = relative_pose_error(estimate, truth)
    two = relative_pose_error(estimate, truth, delta=2)
    assert one is not None and two is not None
    assert (one.translation.rmse, two.translation.rmse) == pytest.approx((0.03, 0.06))
    assert (len(one.frames), len(two.frames)) == (4, 3)
    estimate[:, :3, :3] = Rotation.from_rotvec([[0, 0, np.deg2rad(i)] for i in range(5)]).as_matrix()
    turned = relative_pose_error(estimate, truth, delta=2)
    assert turned is not None and turned.rotation.max == pytest.approx(2)
    assert relative_pose_error(estimate, truth, delta=30) is None


def test_a_rigid_motion_is_no_error() -> None:
    truth, _ = random_walk(50, 0)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(random_state=1).as_matrix(), [3, 2, 1]
    ate, rpe = absolute_trajectory_error(T @ truth, truth), relative_pose_error(T @ truth, truth)
    assert rpe is not None
    assert ate.translation.max < 1e-12 and rpe.translation.max < 1e-12 and rpe.rotation.max < 1e-5
    assert np.allclose(ate.T_gt_est @ T, np.eye(4))


def test_frames_without_ground_truth_take_no_part() -> None:
    truth, estimate = random_walk(40, 2)
    holes = [0, 7, 8, 39]
    spoilt = estimate.copy()
    spoilt[holes, :3, 3] += 100
    with_holes = truth.copy()
    with_holes[holes] = np.nan
    kept = np.setdiff1d(np.arange(40), holes)
    ate = absolute_trajectory_error(spoilt, with_holes)
    assert ate.frames.tolist() == kept.tolist()
    assert ate.translation == absolute_trajectory_error(estimate[kept], truth[kept]).translation
    rpe = relative_pose_error(spoilt, with_holes)
    assert rpe is not None and rpe.frames.tolist() == [i for i in range(39) if i in kept and i + 1 in kept]
    assert rpe.translation.max < 1
    with pytest.raises(TrajectoryError, match="no frame has ground truth"):
        absolute_trajectory_error(estimate, np.full_like(truth, np.nan))


def test_ground_truth_is_matched_by_stamp() -> None:
    truth, estimate = random_walk(6, 3)
    dense = Trajectory(np.arange(6) * 0.5, truth)
    matched = matched_ground_truth(Trajectory(np.array([0.501, 0.75, 2.0]), estimate[:3]), dense)
    assert np.array_equal(matched[[0, 2]], truth[[1, 4]]) and np.isnan(matched[1]).all()
    with pytest.raises(TrajectoryError, match="no time stamp"):
        matched_ground_truth(Trajectory(np.array([100.0]), estimate[:1]), dense)
    with pytest.raises(TrajectoryError, match=r"expected \(N, 4, 4\) both"):
        absolute_trajectory_error(estimate, truth[:4])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("delta", [1, 30])
def test_equal_to_evo(seed: int, delta: int) -> None:
    metrics = pytest.importorskip("evo.core.metrics", reason="evo is a development dependency: pip install idf-slam[dev]")
    from evo.core.trajectory import PosePath3D

    truth, estimate = random_walk(120, seed)
    reference, aligned = PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(estimate))
    aligned.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, aligned))
    rpe = {}
    for part in ("translation_part", "rotation_angle_deg"):
        rpe[part] = metrics.RPE(getattr(metrics.PoseRelation, part), delta=delta, delta_unit=metrics.Unit.frames, all_pairs=True)
        rpe[part].process_data((reference, aligned))
    ours = relative_pose_error(estimate, truth, delta=delta)
    assert ours is not None
    pairs = (
        (absolute_trajectory_error(estimate, truth).translation, ape),
        (ours.translation, rpe["translation_part"]),
        (ours.rotation, rpe["rotation_angle_deg"]),
    )
    for mine, theirs in pairs:
        for name, value in vars(mine).items():
            assert value == pytest.approx(theirs.get_all_statistics()[name], abs=1e-6)


def test_the_first_pose_places_a_map_whose_later_centres_are_off() -> None:
    """A short path whose centres are off by centimetres: their alignment turns the map, the first pose does not."""
    truth = np.tile(np.eye(4), (20, 1, 1))
    truth[:, 0, 3] = 0.01 * np.arange(20)
    truth[:, :3, 3] += [1.0, 2.0, 0.0]
    estimate = np.linalg.inv(truth[0]) @ truth
    estimate[1:, 1, 3] += 0.05 * np.sin(np.arange(1, 20))
    estimate[1:, 2, 3] += 0.004 * np.arange(1, 20)
    truth[0] = np.nan
    np.testing.assert_allclose(first_pose_alignment(estimate, truth), truth[1] @ np.linalg.inv(estimate[1]))
    truth[0] = truth[1]
    truth[0, 0, 3] -= 0.01
    np.testing.assert_allclose(first_pose_alignment(estimate, truth), truth[0], atol=1e-12)
    turned = absolute_trajectory_error(estimate, truth).T_gt_est[:3, :3]
    assert np.degrees(np.arccos((np.trace(turned) - 1) / 2)) > 15


def test_poses_on_a_line_are_aligned_in_all_directions() -> None:
    """The centres alone leave the turn about the line open."""
    truth = np.tile(np.eye(4), (3, 1, 1))
    truth[:, 0, 3] = [0.0, 0.1, 0.2]
    T_gt_est = np.eye(4)
    T_gt_est[:3, :3], T_gt_est[:3, 3] = Rotation.from_rotvec([0.5, -0.2, 0.3]).as_matrix(), [1.0, -2.0, 3.0]
    estimate = np.linalg.inv(T_gt_est) @ truth
    truth[1] = np.nan
    np.testing.assert_allclose(pose_alignment(estimate, truth), T_gt_est, atol=1e-12)
    np.testing.assert_allclose(pose_alignment(estimate[:1], truth[:1]), T_gt_est, atol=1e-12)


def test_a_short_path_with_errors_turns_the_map_little() -> None:
    """Two centres 10 cm apart, one 5 cm off to the side. The centres alone turn by 27 degrees; six points 2 m around each turn by 0.03."""
    truth, estimate = np.tile(np.eye(4), (2, 1, 1)), np.tile(np.eye(4), (2, 1, 1))
    truth[1, 0, 3] = estimate[1, 0, 3] = 0.1
    estimate[1, 1, 3] = 0.05
    turn = np.arctan2(-12 * 0.05 * 0.025, 12 * 0.05**2 + 8 * 2.0**2)  # sums of cross and dot products; 8 of the points turn about z
    found = Rotation.from_matrix(pose_alignment(estimate, truth)[:3, :3]).as_rotvec()
    np.testing.assert_allclose(found[2], turn, rtol=1e-6)
    centres = Rotation.from_matrix(absolute_trajectory_error(estimate, truth).T_gt_est[:3, :3]).magnitude()
    assert centres == pytest.approx(np.arctan(0.5))
