"""Trajectories: validation, TUM files with their errors, association, rigid alignment."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idfslam.geometry.trajectory import Trajectory, TrajectoryError, align, is_rotation_determined, load_tum, save_tum


def random_poses(count: int, seed: int) -> NDArray[np.float64]:
    generator = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.random(count, random_state=seed).as_matrix()
    poses[:, :3, 3] = generator.normal(size=(count, 3))
    return poses


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_tum_round_trip(tmp_path: Path) -> None:
    trajectory = Trajectory(1305031098.0 + np.arange(20) / 30, random_poses(20, 0))
    save_tum(tmp_path / "t.txt", trajectory)
    back = load_tum(tmp_path / "t.txt")
    assert np.abs(back.timestamps - trajectory.timestamps).max() < 1e-6
    assert np.abs(back.poses - trajectory.poses).max() < 1e-8


def test_tum_line_by_hand(tmp_path: Path) -> None:
    # A quarter turn about z is (0, 0, sin 45, cos 45): it maps x to y
    path = write(tmp_path / "t.txt", "# comment\n\n  # another\n1.5 1 2 3 0 0 0.70710678 0.70710678\n")
    trajectory = load_tum(path)
    assert len(trajectory) == 1 and trajectory.timestamps[0] == 1.5
    expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    assert np.allclose(trajectory.poses[0], expected, atol=1e-8)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# only a comment\n", "no poses"),
        ("0 0 0 0 0 0 0 1\n1 2 3\n", r"t\.txt:2: 3 values; expected 8"),
        ("0 0 0 zero 0 0 0 1\n", r"t\.txt:1: .*not a number"),
        ("#\n0 nan 0 0 0 0 0 1\n", r"t\.txt:2: .*not finite"),
        ("0 0 0 0 0 0 0 2\n", r"t\.txt:1: .*norm is 2"),
    ],
)
def test_damaged_tum_files_name_the_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(TrajectoryError, match=message):
        load_tum(write(tmp_path / "t.txt", text))


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match="no such file"):
        load_tum(tmp_path / "missing.txt")
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00\x93")
    with pytest.raises(TrajectoryError, match="not a text file"):
        load_tum(tmp_path / "binary.txt")


def test_validation() -> None:
    good = random_poses(3, 1)
    with pytest.raises(TrajectoryError, match=r"expected \(N,\) and \(N, 4, 4\)"):
        Trajectory(np.arange(2), good)
    for spoil, message in ((np.nan, "pose 1 .* not finite"), (5.0, "pose 1 .* not a rigid transform")):
        bad = good.copy()
        bad[1, 0, 0] = spoil
        with pytest.raises(TrajectoryError, match=message):
            Trajectory(np.arange(3), bad)
    mirrored = good.copy()
    mirrored[2, :3, :3] *= -1
    with pytest.raises(TrajectoryError, match=r"pose 2 .* det R = -1"):
        Trajectory(np.arange(3), mirrored)
    assert len(Trajectory(np.zeros(0), np.zeros((0, 4, 4)))) == 0


def test_of_known_leaves_out_frames_without_a_pose() -> None:
    poses = random_poses(4, 2)
    poses[[0, 2]] = np.nan
    assert Trajectory.of_known(np.arange(4), poses).timestamps.tolist() == [1, 3]


@given(seed=st.integers(0, 10_000), count=st.integers(3, 40))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_alignment_is_exact_without_noise(seed: int, count: int) -> None:
    T, points = random_poses(1, seed)[0], np.random.default_rng(seed).normal(size=(count, 3))
    assert np.abs(align(points, points @ T[:3, :3].T + T[:3, 3]) - T).max() < 1e-10


def test_alignment_of_a_mirror_image_is_a_rotation() -> None:
    points = np.random.default_rng(0).normal(size=(20, 3))
    R = align(points, points * [1, 1, -1])[:3, :3]
    assert np.linalg.det(R) == pytest.approx(1) and np.allclose(R.T @ R, np.eye(3))


def test_alignment_of_points_in_a_plane() -> None:
    T, points = random_poses(1, 3)[0], np.random.default_rng(1).normal(size=(10, 3)) * [1, 1, 0]
    assert np.abs(align(points, points @ T[:3, :3].T + T[:3, 3]) - T).max() < 1e-10


def test_alignment_needs_points() -> None:
    with pytest.raises(TrajectoryError, match="cannot align"):
        align(np.zeros((0, 3)), np.zeros((0, 3)))
    with pytest.raises(TrajectoryError, match="cannot align"):
        align(np.zeros((4, 3)), np.zeros((5, 3)))


def test_when_the_rotation_is_determined() -> None:
    line = np.linspace(0, 1, 10)[:, None] * [1.0, 2.0, 3.0]
    assert not is_rotation_determined(line)
    assert not is_rotation_determined(np.zeros((5, 3)))
    assert is_rotation_determined(np.random.default_rng(0).normal(size=(10, 3)))
