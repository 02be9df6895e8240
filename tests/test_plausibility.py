"""What cannot be right about a recording is said in one line with its likely cause; what can be right is not doubted."""

import logging
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.box_room import write_box_recording
from helpers.recordings import write_folder, write_tum
from helpers.shared_data import shared_recording
from idfslam.datasets import open_recording
from idfslam.datasets.cameras.plausibility import doubts, in_fractions, lens_doubt, of_another_size
from idfslam.datasets.plausibility import clipping_doubt, depth_doubt, stamps_doubt, steps_doubt
from idfslam.errors import ConfigError, FrameError, RecordingError
from idfslam.geometry.camera import Camera

KINECT = Camera(640, 480, 527.2, 527.2, 322.25, 238.73)


def depths(near: float, far: float) -> np.ndarray:
    """(N,) [m], evenly between."""
    return np.linspace(near, far, 1000).astype(np.float32)


ROOM = depths(0.8, 4.0)


def scaled(camera: Camera, factor: float) -> Camera:
    """A camera meant for images `factor` times as large, stated for the images that it has now."""
    other = camera.resized(round(camera.width * factor), round(camera.height * factor))
    return replace(other, width=camera.width, height=camera.height)


# ----- depth


@pytest.mark.parametrize(
    ("true", "stated"), [(1000, 5000), (5000, 1000), (1000, 6553.5), (6553.5, 1000), (1, 1000), (1000, 1), (10000, 1000)]
)
def test_a_scale_that_nobody_stated_is_doubted_if_another_gives_a_room(true: float, stated: float) -> None:
    doubt = depth_doubt(ROOM * true / stated, stated, assumed=True)
    assert doubt is not None
    assert f"the depth scale of 1/{stated:g} m is probably wrong; give --camera.depth-scale " in doubt


@pytest.mark.parametrize(("true", "stated"), [(1000, 5000), (5000, 1000), (1000, 1), (1, 1000)])
def test_a_stated_scale_is_doubted_where_no_depth_camera_measures(true: float, stated: float) -> None:
    doubt = depth_doubt(depths(0.8, 5.0) * true / stated, stated, assumed=False)
    assert doubt is not None and "probably wrong" in doubt


@pytest.mark.parametrize("assumed", [True, False])
@pytest.mark.parametrize("scale", [1.0, 1000.0, 5000.0])
@pytest.mark.parametrize(
    "sample",
    [ROOM, depths(0.3, 0.9), depths(0.5, 8.0), depths(1.0, 12.0), depths(2.0, 20.0), np.zeros(0, np.float32)],
    ids=["room", "a thing on a table", "corridor", "hall", "outdoors", "nothing"],
)
def test_what_depth_cameras_see_is_not_doubted(sample: np.ndarray, scale: float, assumed: bool) -> None:
    likelier_a_room = scale == 5000.0 and assumed and bool(len(sample)) and sample.max() < 1  # in millimetres, a room
    assert (depth_doubt(sample, scale, assumed=assumed) is not None) == likelier_a_room


def clipped(far: float, at: float = 2.0) -> np.ndarray:
    """(N,) [m] millimetres of a room whose far side lies at `far`, clipped."""
    return np.minimum(np.round(depths(0.8, far), 3), at).astype(np.float32)


def test_a_sensor_that_clips_what_is_farther() -> None:
    doubt = clipping_doubt([clipped(3.0), clipped(3.2), clipped(1.6), clipped(2.8), clipped(2.4)])
    assert doubt == (
        "depth ends at 2.00 m in 4 of 5 frames that were looked at, with 40 % of it: "
        "the sensor probably clips what is farther; give --camera.reach 2, so that it counts as no reading"
    )


def test_walls_and_steps_of_depth_are_no_clipping() -> None:
    assert clipping_doubt([]) is None
    assert clipping_doubt([clipped(3.0, 2.0), clipped(3.0, 2.1), clipped(3.0, 2.2), clipped(3.0, 2.3), clipped(3.0, 2.4)]) is None  # walls
    assert clipping_doubt([clipped(3.0), clipped(3.0), clipped(1.9), clipped(1.8), clipped(1.7)]) is None  # two frames
    coarse = (np.round(depths(0.8, 4.0) / 0.25) * 0.25).astype(np.float32)  # a Kinect's steps, coarse as at 9 m
    assert clipping_doubt([coarse] * 5) is None


def in_steps_of_disparity(pixels: float) -> np.ndarray:
    """(N,) [m] of a stereo camera with a baseline of 7.5 cm and a focal length of 580 px, whose disparity has steps of so many pixels."""
    product = 0.075 * 580
    return (product / (np.round(product / depths(0.8, 4.0) / pixels) * pixels)).astype(np.float32)


def test_stereo_in_whole_pixels_is_told() -> None:
    assert steps_doubt([in_steps_of_disparity(1.0)] * 2, 0.0015) == (
        "depth comes in steps of 13 cm at 2.3 m, which hide more than the noise that is assumed; --alignment.depth-noise 0.0057 suits it"
    )


@pytest.mark.parametrize(
    "sample",
    [in_steps_of_disparity(1 / 8), depths(0.8, 4.0), np.round(depths(0.8, 4.0), 3), np.full(100, 2.0, np.float32), np.zeros(0, np.float32)],
    ids=["a Kinect", "exact", "millimetres", "a wall", "nothing"],
)
def test_fine_steps_are_not(sample: np.ndarray) -> None:
    assert steps_doubt([sample] * 2, 0.0015) is None
    assert steps_doubt([], 0.0015) is None


def test_depth_from_the_reach_on_is_no_reading(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write_box_recording(tmp_path / "box")
    for path in (folder / "depth").iterdir():
        cv2.imwrite(str(path), np.minimum(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), 1900))
    with caplog.at_level(logging.WARNING):
        as_it_is = open_recording(folder)[0].depth
    assert "depth ends at 1.90 m in 5 of 5 frames" in caplog.text
    assert "give --camera.reach 1.9," in caplog.text
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        near = open_recording(folder, camera={"reach": 1.9})[0].depth
    assert not caplog.text
    assert (near == np.where(as_it_is < 1.9, as_it_is, 0)).all()
    assert 0.2 < (near > 0).mean() < (as_it_is > 0).mean() == 1
    with pytest.raises(ConfigError, match="a reach of -1 m, expected metres above 0"):
        open_recording(folder, camera={"reach": -1.0})


def test_depth_beyond_a_sensor_s_reach() -> None:
    sample = np.concatenate([depths(2, 9), np.full(500, 60, np.float32)])
    assert depth_doubt(sample, 1000, assumed=False) == (
        "33 % of the depth is beyond 20 m, which few depth cameras reach: check the depth scale (--camera.depth-scale), "
        "or store 0 where there is no reading"
    )


# ----- the camera


@pytest.mark.parametrize(
    "camera",
    [
        KINECT,
        Camera(640, 480, 481.2, 480.0, 319.5, 239.5),  # ICL-NUIM
        Camera(640, 480, 517.3, 516.5, 318.6, 255.3),  # TUM freiburg1
        Camera(1200, 680, 600.0, 600.0, 599.5, 339.5),  # Replica
        Camera(640, 360, 305.0, 305.0, 319.0, 183.0),  # Azure Kinect's colour
        Camera(480, 640, 711.0, 711.0, 240.0, 323.0),  # a phone held upright
        Camera(848, 480, 425.0, 425.0, 424.0, 238.0),  # RealSense's depth
        Camera(1280, 720, 700.0, 700.0, 640.0, 360.0),  # ZED
    ],
)
def test_cameras_on_the_market_are_not_doubted(camera: Camera) -> None:
    assert list(doubts(camera, "K.txt")) == []


@pytest.mark.parametrize("factor", [0.25, 1 / 3, 0.5, 2.0, 3.0, 4.0])
def test_the_size_that_a_camera_is_meant_for_is_found(factor: float) -> None:
    meant = of_another_size(scaled(KINECT, factor))
    assert meant is not None
    assert (meant.width, meant.height) == (round(640 * factor), round(480 * factor))


def test_a_camera_of_half_the_size_is_doubted_once_with_the_right_flags() -> None:
    assert list(doubts(scaled(KINECT, 0.5), "K.txt")) == [
        "the principal point (160.9, 119.1) of K.txt is far from the middle of the image: the camera is probably of 320x240 images; "
        "then give --camera.fx 527.2 --camera.fy 527.2 --camera.cx 322.2 --camera.cy 238.7"
    ]


def test_other_impossible_cameras() -> None:
    assert list(doubts(replace(KINECT, cy=400.0), "K.txt")) == [
        "the principal point (322.2, 400.0) of K.txt is far from the middle of the image: give --camera.cx and --camera.cy of these images"
    ]
    (wide,) = doubts(replace(KINECT, fx=85.7, fy=85.7), "K.txt")
    assert wide == "the focal length 85.7 px of K.txt means a view of 150 degrees, expected 20 to 120: give --camera.fx, --camera.fy"
    (narrow,) = doubts(replace(KINECT, fx=5272.0, fy=5272.0), "K.txt")
    assert "a view of 7 degrees" in narrow
    (stretched,) = doubts(replace(KINECT, fy=KINECT.fx * 4 / 3), "K.txt")
    assert stretched.startswith("fx 527.2 and fy 702.9 of K.txt differ by 25 %, expected square pixels")


def test_fractions_of_the_image_are_recognised() -> None:
    pixels = in_fractions(Camera(640, 480, 0.8238, 1.0984, 0.5035, 0.4974))
    assert pixels is not None
    assert (pixels.fx, pixels.fy) == pytest.approx((527.2, 527.2), abs=0.1)
    assert in_fractions(KINECT) is None


@pytest.mark.parametrize(
    "lens",
    [
        (0.2624, -0.9531, -0.0054, 0.0026, 1.1633),  # TUM freiburg1
        (0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
        (0.0, 0.0, 0.0, 0.0),
        (0.52, -2.7, 0.0003, -0.0004, 1.55, 0.4, -2.5, 1.48),  # Azure Kinect
    ],
)
def test_lenses_on_the_market_are_not_doubted(lens: tuple[float, ...]) -> None:
    assert lens_doubt(KINECT, lens, "K.txt") is None


def test_absurd_distortion_is_doubted() -> None:
    doubt = lens_doubt(KINECT, (527.0, 0.0, 0.0, 0.0), "K.txt")
    assert doubt is not None
    assert doubt.startswith("the distortion 527 0 0 0 of K.txt moves the edge of the image by a factor")
    assert lens_doubt(KINECT, (-3.0, 0.0, 0.0, 0.0, 0.0), "K.txt") is not None


# ----- stamps


def test_stamps_of_cameras_are_not_doubted() -> None:
    for rate in (1.5, 5, 30, 200):
        assert stamps_doubt(1e9 + np.arange(50) / rate, "stamps") is None
    assert stamps_doubt(np.array([0.0, 9.0]), "stamps") is None


def test_frame_numbers_and_other_units_are_doubted() -> None:
    assert stamps_doubt(np.arange(50.0), "timestamps.txt") == (
        "the timestamps.txt are 1 s apart: they are probably frame numbers, expected seconds"
    )
    assert stamps_doubt(np.arange(50) * 4.0, "stamps") == "the stamps mean 0.25 frames/s, expected 1 to 300: are they in seconds?"


# ----- whole recordings


def said(path: Path | str, caplog: pytest.LogCaptureFixture, **arguments: float) -> list[str]:
    caplog.set_level(logging.INFO, "idfslam")
    caplog.clear()
    open_recording(path, **arguments)  # type: ignore[arg-type]
    return caplog.messages


def test_a_recording_is_told_in_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_box_recording(tmp_path / "box")
    (line,) = said(path, caplog)
    camera = open_recording(path).camera
    pinhole = f"f {camera.fx:.1f} {camera.fy:.1f} c {camera.cx:.1f} {camera.cy:.1f}"
    assert line.startswith(f"camera {camera.width}x{camera.height} {pinhole} (")
    assert "(intrinsics.txt), depth 1/1000 m (assumed), median " in line
    assert line.endswith(" m, 30.0 frames/s (assumed), unknown shutter")
    (line,) = said(path, caplog, depth_scale=1000)
    assert ", depth 1/1000 m, median " in line
    caplog.clear()
    open_recording(path, report=False)
    assert caplog.messages == []


def test_millimetres_in_the_layout_of_tum(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_tum(tmp_path / "kitchen")
    (path / "cam_params.json").unlink()
    (path / "intrinsics.txt").write_text("15 0 7.5\n0 15 5.5\n0 0 1\n")
    for file in (path / "depth").iterdir():
        cv2.imwrite(str(file), np.full((12, 16), 1900, np.uint16))
    line, warning = said(path, caplog)
    stamps = "30.0 frames/s (stamps), unknown shutter"
    assert line == f"camera 16x12 f 15.0 15.0 c 7.5 5.5 (intrinsics.txt), depth 1/5000 m (TUM layout), median 0.38 m, {stamps}"
    assert warning == (
        "kitchen: the median depth of 0.38 m is implausibly small: the depth scale of 1/5000 m is probably wrong; "
        "give --camera.depth-scale 1000 (a median of 1.90 m)"
    )
    assert len(said(path, caplog, depth_scale=1000)) == 1


@pytest.mark.parametrize(("unit", "name"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
def test_stamps_in_another_unit_are_converted(unit: float, name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_tum(tmp_path / "kitchen", frames=5)
    for kind in ("rgb", "depth"):
        lines = (line.split() for line in (path / f"{kind}.txt").read_text().splitlines() if line[0] != "#")
        (path / f"{kind}.txt").write_text("".join(f"{round(float(stamp) * unit)} {file}\n" for stamp, file in lines))
    line, *warnings = said(path, caplog)
    assert line == f"{path}: the stamps are taken for {name}, and converted to seconds"
    np.testing.assert_allclose(open_recording(path).timestamps, 100 + np.arange(5) / 30, atol=1e-3)
    assert warnings[0].endswith("frames/s (stamps), unknown shutter") and len(warnings) == 1


def test_a_wrong_camera_is_doubted_when_the_recording_is_opened(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_folder(tmp_path / "room")
    (path / "intrinsics.txt").write_text("7.5 7.5 3.5 2.5")
    _, warning = said(path, caplog)
    assert warning == (
        "room: the principal point (3.5, 2.5) of intrinsics.txt is far from the middle of the image: the camera is probably of 8x6 images; "
        "then give --camera.fx 15.0 --camera.fy 15.0 --camera.cx 7.5 --camera.cy 5.5"
    )


@pytest.mark.parametrize("name", ["synthetic:0", "synthetic:0:kinect", "kidnap:synthetic:0"])
def test_generated_recordings_are_not_doubted(name: str, caplog: pytest.LogCaptureFixture) -> None:
    (line,) = said(name, caplog)
    assert line.endswith("(generated), 30.0 frames/s (generated)")


@pytest.mark.parametrize("name", ["redkitchen", "people_static", "rgbd_dataset_freiburg1_rpy_first"])
def test_real_recordings_are_not_doubted(name: str, caplog: pytest.LogCaptureFixture) -> None:
    (line,) = said(shared_recording(name), caplog)
    assert line.startswith("camera 640x480 f 5")


def test_millimetres_taken_for_a_fifth_of_them_in_a_real_recording(caplog: pytest.LogCaptureFixture) -> None:
    path = shared_recording("redkitchen")
    median = open_recording(path)[0].depth
    assert math.isclose(float(np.median(median[median > 0])), 1.88, abs_tol=0.02)
    assert any("give --camera.depth-scale 1000" in message for message in said(path, caplog, depth_scale=5000))


def test_depth_of_half_the_size_is_taken_for_the_same_view(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_folder(tmp_path / "room")
    for file in (path / "depth").iterdir():
        cv2.imwrite(str(file), np.full((6, 8), 1500, np.uint16))
    line, warning = said(path, caplog)
    assert line.startswith("camera 16x12 f 15.0 15.0 c 7.5 5.5 (intrinsics.txt), depth 1/1000 m (assumed), median 1.50 m")
    assert warning == (
        "room: depth images of 8x6 are taken for the view of the colour images of 16x12; "
        "if a camera of its own took them, describe it in cam_params.json (depth_camera and T_colour_depth)"
    )
    np.testing.assert_allclose(open_recording(path)[1].depth, 1.5, rtol=1e-6)
    cv2.imwrite(str(path / "depth/000000.png"), np.full((12, 16), 1500, np.uint16))  # one of the recording's frames has equal sizes
    recording = open_recording(path)
    assert recording[0].depth.shape == (12, 16)
    with pytest.raises(FrameError, match="frame 1 has colour 16x12 and depth 8x6, expected one size: register the depth"):
        recording[1]


@pytest.mark.parametrize("assumed", [True, False])
@pytest.mark.parametrize("median", [0.35, 6.0])
def test_close_ups_and_halls_in_millimetres_are_not_doubted(median: float, assumed: bool) -> None:
    assert depth_doubt(depths(0.6 * median, 1.4 * median), 1000, assumed=assumed) is None


@pytest.mark.parametrize(("scale", "median", "other"), [(200, 9.4, 1000), (25000, 0.32, 5000), (1000, 8.0, 5000), (5000, 0.35, 1000)])
def test_a_stated_scale_that_is_wrong_by_five_is_doubted(scale: float, median: float, other: float) -> None:
    doubt = depth_doubt(depths(0.6 * median, 1.4 * median), scale, assumed=False)
    assert doubt is not None and f"give --camera.depth-scale {other:g} (a median of {median * scale / other:.2f} m)" in doubt


def test_a_scale_that_puts_everything_too_far_away_is_refused_at_once(tmp_path: Path) -> None:
    folder = write_box_recording(tmp_path / "r")
    with pytest.raises(RecordingError, match=r"frame 0 is \d+ m with the depth scale of 1/1 m.* give --camera.depth-scale 1000"):
        open_recording(folder, depth_scale=1)


def test_ground_truth_of_some_frames_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write_box_recording(tmp_path / "r")
    files = sorted((folder / "pose").iterdir())
    for file in files[1:]:
        file.unlink()
    with caplog.at_level("INFO"):
        open_recording(folder)
    assert f"ground truth for 1 of {len(files)} frames" in caplog.text


@pytest.mark.parametrize(("delay", "told"), [(0.008, ""), (0.015, ", depth 15 ms after colour"), (-0.014, ", depth 14 ms before colour")])
def test_a_delay_of_depth_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture, delay: float, told: str) -> None:
    folder = write_box_recording(tmp_path / "r")
    for name, shift in (("rgb", 0.0), ("depth", delay)):
        for i, file in enumerate(sorted((folder / name).iterdir())):
            file.rename(file.with_name(f"{1700000000 + i / 30 + shift:.6f}{file.suffix}"))
    with caplog.at_level("INFO"):
        open_recording(folder, truth=False)
    assert ("colour" in caplog.text) == bool(told) and told in caplog.text
