"""Record3D and Stray Scanner: sizes, units, confidence, cameras, stamps and ARKit's poses; and what is wrong in one line."""

import re
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import lzfse
import numpy as np
import pytest

from helpers.phones import record3d_entries, write_record3d, write_stray
from helpers.recordings import pose
from helpers.videos import shade, write_video
from idfslam.datasets import open_recording
from idfslam.errors import ConfigError, FrameError, RecordingError
from idfslam.geometry.camera import Camera


def check_depth(depth: np.ndarray) -> None:
    """Four times as many pixels each way: 1 m, but nothing where there was no reading or low confidence in it."""
    assert (depth[:4, :4] == 0).all() and (depth[4:8, 4:8] == 0).all()
    np.testing.assert_allclose(depth[8:], 1.0, rtol=1e-5)  # also at (2, 2), of medium confidence


def check_colour(colour: np.ndarray, i: int) -> None:
    np.testing.assert_allclose(colour.mean((0, 1)) * 255, shade(i)[::-1], atol=6)


def test_stray_scanner(tmp_path: Path) -> None:
    recording = open_recording(write_stray(tmp_path / "scan"))
    assert len(recording) == 3 and recording.name == "scan"
    assert recording.camera == Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
    np.testing.assert_allclose(recording.timestamps, [100, 100 + 1 / 60, 100 + 2 / 60])
    np.testing.assert_allclose(recording.ground_truth, [pose(i) for i in range(3)], atol=1e-9)
    for i in (2, 0, 1):
        frame = recording[i]
        assert frame.colour.shape == (48, 64, 3) and frame.depth.shape == (48, 64)
        check_depth(frame.depth)
        check_colour(frame.colour, i)


def test_stray_scanner_with_a_camera_for_each_frame(tmp_path: Path) -> None:
    """Their median: 60, 61, 62."""
    assert open_recording(write_stray(tmp_path / "scan", cameras=True)).camera == Camera(64, 48, 61.0, 62.0, 31.5, 23.5)


def test_stray_scanner_of_before_there_was_confidence(tmp_path: Path) -> None:
    frame = open_recording(write_stray(tmp_path / "scan", confidence=False))[0]
    assert (frame.depth[:4, :4] == 0).all() and (frame.depth[4:] > 0).all()


def test_large_images_are_reduced_with_their_camera(tmp_path: Path) -> None:
    """1280x960 becomes 640x480; the user's camera is that of the video."""
    path = write_stray(tmp_path / "scan")
    write_video(path / "rgb.mp4", size=(1280, 960))
    camera = {"fx": 1200.0, "fy": 1200.0, "cx": 639.5, "cy": 479.5}
    recording = open_recording(path, camera=camera)
    assert recording.camera == Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
    frame = recording[1]
    assert frame.colour.shape == (480, 640, 3) and frame.depth.shape == (480, 640)
    check_colour(frame.colour, 1)


def test_a_frame_without_a_depth_image_has_the_nearest(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_stray(tmp_path / "scan")
    (path / "depth/000001.png").unlink()
    recording = open_recording(path)
    assert "1 of 3 colour images have no depth image of their own" in caplog.text
    check_colour(recording[1].colour, 1)
    assert recording[1].depth_timestamp == recording[0].timestamp and recording[1].depth.any()
    np.testing.assert_allclose(recording.ground_truth[1], pose(1), atol=1e-9)


def edited(path: Path, old: str, new: str) -> None:
    path.write_text(re.sub(old, new, path.read_text(), count=1, flags=re.S))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: edited(path / "odometry.csv", "qw", "w"), "no column qw, expected timestamp, frame"),
        (lambda path: edited(path / "odometry.csv", r"\n.*", "\n"), "odometry.csv: empty"),
        (lambda path: edited(path / "odometry.csv", "100", "early"), "could not convert string to float: 'early"),
        (lambda path: (path / "rgb.mp4").write_bytes(b"cut off"), "rgb.mp4: not a readable video"),
        (lambda path: [file.unlink() for file in (path / "depth").iterdir()], "3 frames in rgb.mp4, 0 images in depth/ and 3 lines"),
        (lambda path: (path / "camera_matrix.csv").unlink(), "camera is unknown"),
    ],
)  # fmt: skip
def test_a_scan_that_cannot_be_read(damage: Callable[[Path], object], message: str, tmp_path: Path) -> None:
    path = write_stray(tmp_path / "scan")
    damage(path)
    with pytest.raises(RecordingError, match=message) as caught:
        open_recording(path)
    assert "\n" not in str(caught.value)


def test_spaces_around_the_names_of_columns(tmp_path: Path) -> None:
    path = write_stray(tmp_path / "scan")
    edited(path / "odometry.csv", "timestamp", " timestamp\t")
    assert len(open_recording(path)) == 3


def test_wrong_poses_of_a_phone_are_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_stray(tmp_path / "scan")
    edited(path / "odometry.csv", r"1\.0\n", "3.0\n")
    truth = open_recording(path).ground_truth
    assert truth is not None and np.isnan(truth[0]).all() and np.isfinite(truth[1:]).all()
    assert "odometry.csv: the pose of frame 0 is not a rigid transform: 2 of 3 frames have ground truth" in caplog.text
    for poses, message in (([[0, 0, 0, 1, 0, 0, 0]], "1 poses for 3 frames"), ("none", "could not convert"), ([[1, 2]], "reshape")):
        caplog.clear()
        file = write_record3d(tmp_path / "room.r3d", record3d_entries(poses=poses))
        assert open_recording(file).ground_truth is None
        assert message in caplog.text and len(caplog.messages) == 1


def test_a_scan_with_one_bad_frame(tmp_path: Path) -> None:
    path = write_stray(tmp_path / "scan")
    recording = open_recording(path)
    (path / "confidence/000001.png").write_bytes(b"cut off")
    with pytest.raises(FrameError, match=r"000001.png: (empty|cut off|not a readable image)"):
        recording[1]
    assert cv2.imwrite(str(path / "confidence/000001.png"), np.zeros((3, 4), np.uint8))
    with pytest.raises(FrameError, match="of another size than the depth image"):
        recording[1]
    check_colour(recording[2].colour, 2)


def test_record3d(tmp_path: Path) -> None:
    recording = open_recording(write_record3d(tmp_path / "room.r3d"))
    assert len(recording) == 3 and recording.name == "room"
    assert recording.camera == Camera(48, 64, 60.0, 60.0, 23.5, 31.5)
    np.testing.assert_allclose(recording.timestamps, [5, 5 + 1 / 60, 5 + 2 / 60])
    np.testing.assert_allclose(recording.ground_truth, [pose(i) for i in range(3)], atol=1e-9)
    for i in (2, 0, 1):
        check_depth(recording[i].depth)
        check_colour(recording[i].colour, i)


def test_record3d_in_a_folder_and_unpacked(tmp_path: Path) -> None:
    write_record3d(tmp_path / "one/room.r3d")
    assert len(open_recording(tmp_path / "one")) == 3
    for name, data in record3d_entries().items():
        (tmp_path / "unpacked" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "unpacked" / name).write_bytes(data)
    check_depth(open_recording(tmp_path / "unpacked")[1].depth)


def test_record3d_whose_images_are_larger_than_its_camera_says(tmp_path: Path) -> None:
    """The camera holds for 24x32, the images have 48x64."""
    entries = record3d_entries(w=24, h=32, K=[30, 0, 0, 0, 30, 0, 11.5, 15.5, 1])
    assert open_recording(write_record3d(tmp_path / "room.r3d", entries)).camera == Camera(48, 64, 60.0, 60.0, 23.5, 31.5)


def test_record3d_with_a_camera_for_each_frame(tmp_path: Path) -> None:
    entries = record3d_entries(perFrameIntrinsicCoeffs=[[60 + i, 61 + i, 23.5, 31.5] for i in range(3)])
    assert open_recording(write_record3d(tmp_path / "room.r3d", entries)).camera == Camera(48, 64, 61.0, 62.0, 23.5, 31.5)


def test_record3d_without_stamps_poses_and_confidence(tmp_path: Path) -> None:
    entries = record3d_entries(frameTimestamps=None, poses=None, fps=60)
    recording = open_recording(write_record3d(tmp_path / "room.r3d", {k: v for k, v in entries.items() if not k.endswith("conf")}))
    assert recording.ground_truth is None
    np.testing.assert_allclose(recording.timestamps, [0, 1 / 60, 2 / 60])
    assert (recording[0].depth[:4, :4] == 0).all() and (recording[0].depth[4:] > 0).all()


def without(name: str) -> dict[str, bytes]:
    return {key: value for key, value in record3d_entries().items() if key != name}


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        (without("metadata"), "metadata is missing"),
        (without("rgbd/0.jpg"), "no rgbd/0.jpg"),
        (record3d_entries() | {"metadata": b"{"}, "is not JSON"),
        (record3d_entries() | {"metadata": b"[]"}, "values of other kinds, expected Record3D's K"),
        (record3d_entries(K=[1, 2]), "cannot reshape array of size 2"),
        (record3d_entries(dw=-12, dh=-16), r"sizes \(48, 64\) and \(-12, -16\), expected Record3D's K, w, h, poses"),
        (record3d_entries(dw=13), r"rgbd/0.depth holds 768 bytes, expected 13x16 of 4"),
        (record3d_entries() | {"rgbd/0.jpg": b"cut off"}, "rgbd/0.jpg: not a readable image"),
    ],
)
def test_a_record3d_file_that_cannot_be_read(entries: dict[str, bytes], message: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=message) as caught:
        open_recording(write_record3d(tmp_path / "room.r3d", entries))
    assert "\n" not in str(caught.value)


def test_a_record3d_file_that_was_cut_off(tmp_path: Path) -> None:
    path = write_record3d(tmp_path / "room.r3d")
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(RecordingError, match="File is not a zip file, expected a zip as Record3D exports it"):
        open_recording(path)


def test_a_record3d_file_with_one_bad_frame(tmp_path: Path) -> None:
    damaged = {"rgbd/1.depth": b"not packed", "rgbd/2.conf": lzfse.compress(b"short")}
    recording = open_recording(write_record3d(tmp_path / "room.r3d", record3d_entries() | damaged))
    with pytest.raises(FrameError, match=r"rgbd/1\.depth cannot be unpacked, expected LZFSE"):
        recording[1]
    with pytest.raises(FrameError, match=r"rgbd/2\.conf holds 5 bytes, expected 12x16 of 1"):
        recording[2]
    path = write_record3d(tmp_path / "other.r3d")
    data = bytearray(path.read_bytes())
    data[data.index(b"bvx") + 5] ^= 255  # in the first depth image
    path.write_bytes(data)
    with pytest.raises(FrameError, match=r"rgbd/0\.depth is damaged"):
        open_recording(path)[0]


def test_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scan, room = write_stray(tmp_path / "scan"), write_record3d(tmp_path / "room.r3d")
    for name in ("av", "lzfse"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ConfigError, match=r"-m pip install av$"):
        open_recording(scan)
    with pytest.raises(ConfigError, match=r"-m pip install lzfse$"):
        open_recording(room)
