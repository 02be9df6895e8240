"""Where a virtual camera goes, and the videos of it."""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.box_room import box_poses
from idfslam.cli import command_line
from idfslam.errors import ConfigError, ResultError
from idfslam.geometry.kitti import save_kitti
from idfslam.geometry.trajectory import Trajectory, save_tum
from idfslam.pictures.camera_paths import fly_through, load_poses, orbit
from idfslam.pictures.video import write_video

UP = np.array([0.0, -1.0, 0.0])


def angles(poses: np.ndarray) -> np.ndarray:
    """(N-1,) [deg] between one pose and the next."""
    R = poses[:-1, :3, :3].transpose(0, 2, 1) @ poses[1:, :3, :3]
    return np.rad2deg(np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1)))


def test_poses_of_every_kind_of_file(tmp_path: Path) -> None:
    poses = box_poses()
    save_tum(tmp_path / "a.txt", Trajectory(np.arange(len(poses)) / 30, poses))
    save_kitti(tmp_path / "b.txt", poses)
    frames = [{"transform_matrix": (T @ np.diag([1, -1, -1, 1])).tolist()} for T in poses]
    (tmp_path / "c.json").write_text(json.dumps({"frames": frames, "w": 64, "h": 48, "fl_x": 60, "cx": 32, "cy": 24}))
    for name in ("a.txt", "b.txt", "c.json"):
        np.testing.assert_allclose(load_poses(tmp_path / name)[0], poses, atol=1e-8)
    camera = load_poses(tmp_path / "c.json")[1]
    assert camera is not None
    assert (camera.width, camera.fy, camera.cx, camera.cy) == (64, 60, 31.5, 23.5)


@pytest.mark.parametrize("text", ["", "1 2 3\n", "{}", '{"frames": [{"transform_matrix": [1, 2]}]}'])
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "poses.txt").write_text(text)
    with pytest.raises(ResultError, match=r"poses\.txt"):
        load_poses(tmp_path / "poses.txt")


def test_a_flight_keeps_to_the_way_without_its_shake() -> None:
    """A straight walk of 3 m with 5 mm and 0.5 degrees of shake."""
    rng = np.random.default_rng(0)
    poses = np.tile(np.eye(4), (90, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 3, 90)
    poses[:, :3, 3] += rng.normal(0, 0.005, (90, 3))
    for T in poses:
        T[:3, :3] = cv2.Rodrigues(rng.normal(0, np.deg2rad(0.5), 3))[0]
    flight = fly_through(poses, 60, fps=30)
    assert flight.shape == (60, 4, 4)
    np.testing.assert_allclose(flight[:, :3, 3], np.stack([np.linspace(0, 3, 60), np.zeros(60), np.zeros(60)], -1), atol=0.03)
    np.testing.assert_allclose(flight[:, :3, :3].transpose(0, 2, 1) @ flight[:, :3, :3], np.tile(np.eye(3), (60, 1, 1)), atol=1e-9)
    assert angles(flight).max() < 0.2 < angles(poses).mean()
    jerk = np.linalg.norm(np.diff(flight[:, :3, 3], 2, axis=0), axis=-1)
    assert jerk.max() < 0.001


def test_short_flights() -> None:
    for count in (1, 2, 3):
        assert np.isfinite(fly_through(box_poses()[:count], 10, fps=30)).all()


def test_an_orbit_looks_all_around_level() -> None:
    flight = orbit(box_poses(), 8, up=UP, centre=np.array([0.0, 0, 0.5]), radius=0.2)
    assert angles(flight) == pytest.approx(np.full(7, 45.0))
    np.testing.assert_allclose(np.linalg.norm(flight[:, [0, 2], 3] - [0, 0.5], axis=-1), 0.2)
    np.testing.assert_allclose(flight[:, :3, 1], np.tile(-UP, (8, 1)), atol=1e-9)  # image down is down
    outwards = ((flight[:, :3, 3] - flight[:, :3, 3].mean(0)) * flight[:, :3, 2]).sum(-1)
    np.testing.assert_allclose(outwards, 0.2)


def played(path: Path) -> list[np.ndarray]:
    """The frames (H, W, 3) BGR that a player gets from a file."""
    video = cv2.VideoCapture(str(path))
    frames = []
    while (read := video.read())[0]:
        frames.append(read[1])
    video.release()
    return frames


@pytest.mark.parametrize("codec", ["h264", "opencv"])
def test_a_video_plays(tmp_path: Path, codec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if codec == "h264":
        pytest.importorskip("av", reason="PyAV is not installed: H.264 was not tried")
    else:
        monkeypatch.setitem(sys.modules, "av", None)
    v, u = np.mgrid[:49, :81]
    images = [np.stack([u * 3, v * 4, np.full_like(u, 25 * i)], -1).astype(np.uint8) for i in range(10)]
    assert write_video(tmp_path / "a.mp4", images, fps=25) == 10
    frames = played(tmp_path / "a.mp4")
    assert len(frames) == 10
    assert frames[0].shape == (48, 80, 3)
    for image, frame in zip(images, frames):
        assert np.abs(frame[..., ::-1].astype(int) - image[:48, :80]).mean() < 8
    assert cv2.VideoCapture(str(tmp_path / "a.mp4")).get(cv2.CAP_PROP_FPS) == pytest.approx(25)


def test_videos_are_mp4(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"written as \.mp4"):
        write_video(tmp_path / "a.gif", [], fps=25)


@pytest.mark.parametrize("kind", ["along", "orbit"])
def test_videos_of_a_map(known_run: Path, tmp_path: Path, kind: str) -> None:
    path = tmp_path / "v.mp4"
    command_line.main(["render", str(known_run), "--video", kind, "--seconds", "0.5", "--fps", "10", "--width", "64", "--out", str(path)])
    frames = played(path)
    assert [frame.shape for frame in frames] == [(48, 64, 3)] * 5
    assert frames[0].mean() > 60  # the room, not black
    assert np.abs(frames[0].astype(int) - frames[2]).mean() > 3


def test_views_from_a_file(known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The wall ahead is where it is: the box ends at z = 1.8."""
    T = np.eye(4)
    T[:3, 3] = [0.6, 0, 0.8]
    save_kitti(tmp_path / "poses.txt", T[None])
    for width in ("8", "999999999"):
        with pytest.raises(SystemExit):
            command_line.main(["render", str(known_run), "--width", width, "--out", str(tmp_path / "out")])
        assert capsys.readouterr().err == f"error: --width {width}, expected 16 to 16384 pixels\n"
    command_line.main(["render", str(known_run), "--poses", str(tmp_path / "poses.txt"), "--width", "32", "--out", str(tmp_path / "out")])
    depth = cv2.imread(str(tmp_path / "out" / "000000-depth.png"), cv2.IMREAD_UNCHANGED)
    assert depth.shape == (24, 32)
    assert int(depth[12, 16]) == pytest.approx(1000, abs=25)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--poses", "none.txt"], "cannot be read as text"),
        (["--width", "3"], "expected 16 to 16384 pixels"),
        (["--video", "along", "--fps", "0"], "two frames or more"),
        (["--video", "along", "--out", "a.avi"], "written as .mp4"),
    ],
)
def test_wrong_input(known_run: Path, capsys: pytest.CaptureFixture[str], flags: list[str], message: str) -> None:
    with pytest.raises(SystemExit) as caught:
        command_line.main(["render", str(known_run), *flags])
    assert caught.value.code == 1
    assert message in capsys.readouterr().err
