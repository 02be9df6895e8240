"""Recordings that state camera and pose of each frame: transforms.json, Polycam, 3D Scanner App."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from helpers.posed_recordings import (
    by_names,
    write_frame_lines,
    write_nerf_capture,
    write_nerfstudio,
    write_polycam,
    write_scanner_app,
)
from helpers.recordings import HEIGHT, WIDTH, depth_image, pose, write_folder
from idfslam.datasets import open_recording
from idfslam.errors import RecordingError
from idfslam.export.images import PosedImage, write_images
from idfslam.export.nerfstudio import write_transforms
from idfslam.geometry.camera import Camera

CAMERA = Camera(WIDTH, HEIGHT, 15.0, 15.0, 7.5, 5.5)


def check(path: Path, *, depth: float = 1.0) -> None:
    recording = open_recording(path)
    assert len(recording) == 3 and recording.camera == CAMERA
    for i in range(3):
        assert recording[i].colour[6, 8, 0] == pytest.approx((10 + i) / 255, abs=2.5 / 255)
        assert recording[i].depth[6, 8] == pytest.approx(depth, abs=1e-4) and recording[i].depth[0, 0] == 0
    assert recording.ground_truth is not None
    np.testing.assert_allclose(recording.ground_truth, [pose(i) for i in range(3)], atol=1e-6)


def test_nerfstudio(tmp_path: Path) -> None:
    path = write_nerfstudio(tmp_path / "room")
    check(path)
    np.testing.assert_allclose(open_recording(path).timestamps, [0, 1 / 30, 2 / 30])
    assert len(open_recording(path / "transforms.json")) == 3


def test_nerf_capture(tmp_path: Path) -> None:
    check(write_nerf_capture(tmp_path / "room"))
    np.testing.assert_allclose(open_recording(tmp_path / "room").timestamps, [50, 50.1, 50.2])


def test_what_export_writes_is_read_again(tmp_path: Path) -> None:
    original = open_recording(write_folder(tmp_path / "room"))
    images = [PosedImage(f"{i:06d}.png", pose(i), original[i]) for i in range(3)]
    write_transforms(tmp_path / "export/transforms.json", write_images(tmp_path / "export", images))
    check(tmp_path / "export")
    again = open_recording(tmp_path / "export")
    for i in range(3):
        np.testing.assert_allclose(again[i].colour, original[i].colour, atol=1e-6)
        np.testing.assert_allclose(again[i].depth, original[i].depth, atol=1e-6)


@pytest.mark.parametrize("unit", ["depth_unit_scale_factor", "integer_depth_scale"])
def test_the_stated_unit_of_depth_counts_and_the_users_wins(unit: str, tmp_path: Path) -> None:
    path = write_nerfstudio(tmp_path / "room", change=lambda values: values.update({unit: 0.0005}))
    check(path, depth=0.5)
    assert open_recording(path, depth_scale=500)[0].depth[6, 8] == pytest.approx(2)
    assert open_recording(path, camera={"fx": 20.0}).camera == Camera(WIDTH, HEIGHT, 20.0, 15.0, 7.5, 5.5)


def test_float_depth_is_metres(tmp_path: Path) -> None:
    path = write_nerfstudio(tmp_path / "room")
    text = (path / "transforms.json").read_text()
    for i in range(3):
        np.save(path / f"depth/frame_{i:05d}.npy", depth_image(1000) / np.float32(1000))
        text = text.replace(f"depth/frame_{i:05d}.png", f"depth/frame_{i:05d}.npy")
    (path / "transforms.json").write_text(text)
    check(path)


def test_which_frames_are_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_nerfstudio(tmp_path / "room", frames=5, change=lambda values: values["frames"][4].update(fl_x=30.0))
    (path / "depth/frame_00003.png").unlink()
    recording = open_recording(path)
    assert [recording[i].depth.any() for i in range(len(recording))] == [True, True, True, False]  # nobody states stamps
    assert "1 of 4 colour images have no depth image of their own" in caplog.text
    (path / "images/frame_00003.png").unlink()
    check(path)
    assert "1 image is left out: images/frame_00003.png is missing" in caplog.text
    assert "1 image is left out: frame_00004.png is of another camera" in caplog.text


def test_distortion_is_removed_and_a_fisheye_refused(tmp_path: Path) -> None:
    straight = open_recording(write_nerfstudio(tmp_path / "a"))
    bent = open_recording(write_nerfstudio(tmp_path / "b", change=lambda values: values.update(k1=-0.3)))
    assert straight.camera == bent.camera
    assert (straight[0].depth > 0).all() != (bent[0].depth > 0).all() or not np.array_equal(straight[0].depth, bent[0].depth)
    fisheye = write_nerfstudio(tmp_path / "c", change=lambda values: values.update(k1=-0.3, camera_model="OPENCV_FISHEYE"))
    with pytest.raises(RecordingError, match="camera_model OPENCV_FISHEYE, expected OPENCV or PINHOLE: undistort the images"):
        open_recording(fisheye)


def test_without_depth_the_near_miss_is_named(tmp_path: Path) -> None:
    def drop(values: dict) -> None:
        for frame in values["frames"]:
            del frame["depth_file_path"]

    path = write_nerfstudio(tmp_path / "room", change=drop)
    assert len(open_recording(path, camera={"fx": 15.0, "fy": 15.0, "cx": 7.5, "cy": 5.5})) == 3  # images/ and depth/: a plain folder
    (path / "depth").rename(tmp_path / "elsewhere")
    with pytest.raises(RecordingError, match=r"looks like a folder of nerfstudio without depth images \(depth_file_path in it\)"):
        open_recording(path)


@pytest.mark.parametrize(
    "change",
    [
        lambda values: values.update(frames=5),
        lambda values: values.update(frames=[{"depth_file_path": 5}]),
        lambda values: values.update(frames=["depth_file_path"]),
        lambda values: values.update(fl_x="wide"),
        lambda values: values.update(fl_x=[1]),
        lambda values: values.update(fl_x=float("nan")),
        lambda values: values.update(w=10**400),
        lambda values: values["frames"][0].update(file_path="../" * 3000),
        lambda values: values["frames"][0].update(file_path="a\0b"),
        lambda values: values["frames"][0].update(transform_matrix=[[1, 2], [3]]),
        lambda values: values["frames"][0].update(timestamp="noon"),
    ],
)
def test_malformed_files_are_one_line(change: Callable[[dict], object], tmp_path: Path) -> None:
    path = write_nerfstudio(tmp_path / "room", change=change)
    try:
        recording = open_recording(path)
        assert len(recording) in (2, 3) and recording.ground_truth is not None
    except RecordingError as error:
        assert "\n" not in str(error)


# ----- apps whose depth is smaller than colour


@pytest.mark.parametrize("write", [write_polycam, lambda path: write_polycam(path, corrected=False), write_scanner_app])
def test_depth_smaller_than_colour(write: Callable[[Path], Path], tmp_path: Path) -> None:
    recording = open_recording(write(tmp_path / "room"))
    assert len(recording) == 3 and recording.camera == Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
    np.testing.assert_allclose(np.diff(recording.timestamps), 0.1, atol=1e-6)
    depth = recording[1].depth
    assert depth.shape == (48, 64)
    np.testing.assert_allclose(depth[8:40], 1, rtol=1e-5)
    np.testing.assert_array_equal(depth[46:], 0)  # of low confidence
    assert recording.ground_truth is not None
    np.testing.assert_allclose(recording.ground_truth, [pose(i) for i in range(3)], atol=1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.uint16])
@pytest.mark.parametrize("change", [lambda values, i: None, by_names])
def test_a_line_of_json_for_each_frame_and_raw_depth(dtype: type, change: Callable[[dict, int], object], tmp_path: Path) -> None:
    recording = open_recording(write_frame_lines(tmp_path / "room", dtype=dtype, change=change))
    assert len(recording) == 3 and recording.camera == Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
    np.testing.assert_allclose(recording.timestamps, [3, 3.1, 3.2])
    np.testing.assert_allclose(recording[1].depth[8:], 1, rtol=1e-5)
    assert recording.ground_truth is not None
    np.testing.assert_allclose(recording.ground_truth, [pose(i) for i in range(3)], atol=1e-6)


def test_a_malformed_line_is_named(tmp_path: Path) -> None:
    path = write_frame_lines(tmp_path / "room")
    text = (path / "frames.jsonl").read_text().splitlines()
    for line in ("{", "[]", '{"intrinsics": [1, 2]}', '{"transform": 5}', "[" * 100_000):
        (path / "frames.jsonl").write_text("\n".join([text[0], line, *text[2:]]))
        with pytest.raises(RecordingError, match=r"frames\.jsonl: line 2: ") as caught:
            open_recording(path)
        assert "\n" not in str(caught.value)


def test_polycam_without_depth_is_named(tmp_path: Path) -> None:
    path = write_polycam(tmp_path / "room")
    (path / "keyframes/depth").rename(tmp_path / "elsewhere")
    with pytest.raises(RecordingError, match="looks like Polycam's raw data without keyframes/depth"):
        open_recording(path)
