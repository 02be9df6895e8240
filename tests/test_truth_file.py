"""The true trajectory of a run from a file: every form, by stamps and by order, and the lines about what does not fit."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.recordings import freiburg, pose
from idfslam.datasets.poses.pose_file import from_quaternions
from idfslam.errors import IdfSlamError
from idfslam.evaluation.evaluate import evaluate
from idfslam.evaluation.trajectory_error import absolute_trajectory_error
from idfslam.evaluation.truth_file import has_assumed_stamps, read_truth
from idfslam.evaluation.truth_plausibility import wrong_convention
from idfslam.geometry.trajectory import Trajectory, save_tum

POSES = np.stack([pose(i) for i in range(6)])
ASSUMED = Trajectory(np.round(np.arange(6) / 30, 6), POSES)  # as trajectory.txt has them
STAMPED = Trajectory(1700000000.5 + np.arange(6) / 10, POSES)


def tum(stamps: np.ndarray, unit: float = 1) -> str:
    return "".join(freiburg(f"{stamp * unit:.6f}", i) + "\n" for i, stamp in enumerate(stamps))


def test_by_stamps(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "gt.txt").write_text(tum(STAMPED.timestamps + 0.004))
    truth = read_truth(tmp_path / "gt.txt", STAMPED)
    np.testing.assert_allclose(truth.poses, POSES, atol=1e-6)
    (tmp_path / "ns.txt").write_text(tum(STAMPED.timestamps, 1e9))
    assert read_truth(tmp_path / "ns.txt", STAMPED).timestamps == pytest.approx(STAMPED.timestamps, abs=1e-5)
    assert not caplog.messages


@pytest.mark.parametrize("numbers", [12, 16])
def test_poses_without_stamps_are_taken_in_order(numbers: int, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    np.savetxt(tmp_path / "kitti.txt", POSES.reshape(6, 16)[:, :numbers])
    truth = read_truth(tmp_path / "kitti.txt", STAMPED)
    assert np.array_equal(truth.timestamps, STAMPED.timestamps)
    np.testing.assert_allclose(truth.poses, POSES, atol=1e-12)
    assert ["kitti.txt: has no time stamps; its poses are taken in the order of the frames" in text for text in caplog.messages] == [True]
    np.savetxt(tmp_path / "kitti.txt", POSES.reshape(6, 16)[:5, :numbers])
    with pytest.raises(IdfSlamError, match=r"kitti\.txt: 5 poses without time stamps for 6 frames; expected one for each frame, or lines"):
        read_truth(tmp_path / "kitti.txt", STAMPED)


def test_stamps_of_a_run_that_are_assumed(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As many poses as frames are taken in order; another count is an error that offers the fix."""
    assert has_assumed_stamps(ASSUMED) and not has_assumed_stamps(STAMPED)
    (tmp_path / "gt.txt").write_text(tum(STAMPED.timestamps))
    truth = read_truth(tmp_path / "gt.txt", ASSUMED)
    np.testing.assert_allclose(truth.poses, POSES, atol=1e-6)
    assert np.array_equal(truth.timestamps, ASSUMED.timestamps)
    expected = r"30 frames/s assumed.* its poses are taken in the order of the frames"
    assert len(caplog.messages) == 1 and re.search(expected, caplog.messages[0])
    (tmp_path / "gt.txt").write_text(tum(STAMPED.timestamps[:4]))
    with pytest.raises(IdfSlamError, match=r"30 frames/s assumed.*4 poses for 6 frames; give the recording's stamps in timestamps\.txt"):
        read_truth(tmp_path / "gt.txt", ASSUMED)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1 2 3", r"gt\.txt:7: 3 values; expected 8 as in the other lines"),
        ("9 0 0 0 0 0 0 2", r"gt\.txt:7: the quaternion's norm is 2"),
        ("9 0 0 0 nan nan nan nan", r"gt\.txt:7: a value is not finite"),
    ],
)
def test_a_defect_is_an_error_of_one_line(line: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "gt.txt").write_text(tum(STAMPED.timestamps) + line + "\n")
    with pytest.raises(IdfSlamError, match=message) as caught:
        read_truth(tmp_path / "gt.txt", STAMPED)
    assert "\n" not in str(caught.value)
    (tmp_path / "gt.txt").write_bytes(bytes(range(256)) * 40)
    with pytest.raises(IdfSlamError, match=r"gt\.txt.*expected"):
        read_truth(tmp_path / "gt.txt", STAMPED)


def test_no_stamp_in_common_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "gt.txt").write_text(tum(STAMPED.timestamps + 1000))
    save_tum(tmp_path / "trajectory.txt", STAMPED)
    with pytest.raises(IdfSlamError, match=r"no time stamp of the estimate .* give the ground truth of the same recording"):
        evaluate(tmp_path, gt_trajectory=read_truth(tmp_path / "gt.txt", STAMPED))


def test_published_poses_of_three_decimals_are_rigid_enough() -> None:
    """Rounded rotations are off by up to 1e-3 and more; the readers take them, and so does the evaluation."""
    rounded = np.round(POSES, 3)
    assert len(Trajectory.of_known(ASSUMED.timestamps, rounded)) == 6


def test_positions_in_millimetres_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    poses = POSES.copy()
    poses[:, :3, 3] *= 1000  # 0.2 m from pose to pose
    np.savetxt(tmp_path / "kitti.txt", poses.reshape(6, 16))
    read_truth(tmp_path / "kitti.txt", STAMPED)
    assert "the camera moves 200 m from pose to pose, expected metres: are its positions in millimetres?" in caplog.messages[0]


def walk(count: int = 60) -> np.ndarray:
    """(N, 4, 4) a camera that turns and goes up on a spiral of 1 m."""
    poses, angles = np.tile(np.eye(4), (count, 1, 1)), np.linspace(0, 5, count)
    poses[:, :3, :3] = Rotation.from_euler("yxz", np.stack([angles, 0.3 * np.sin(angles), 0.2 * angles], 1)).as_matrix()
    poses[:, :3, 3] = np.stack([np.cos(angles), 0.2 * angles, np.sin(2 * angles)], 1)
    return poses


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda T: T, None),
        (lambda T: T @ np.diag([1.0, -1.0, -1.0, 1.0]), "the orientations differ by 180 degrees; expected the camera's axes"),
        (np.linalg.inv, "the inverses of the true poses fit the run"),
        (lambda T: from_quaternions(T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]), "as qx qy qz qw"),
    ],
)  # fmt: skip
def test_a_truth_in_another_convention_is_told(change: Callable[[np.ndarray], np.ndarray], message: str | None) -> None:
    estimate = np.linalg.inv(walk()[0]) @ walk()
    estimate[:, :3, 3] += np.random.default_rng(0).normal(0, 0.01, (len(estimate), 3))
    truth = change(walk())
    found = wrong_convention(estimate, truth, absolute_trajectory_error(estimate, truth))
    assert found is None if message is None else message in str(found)
