"""Azure Kinect: tracks, calibration of every mode, registration, delays; and what is wrong in one line."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.videos import kinect_calibration, shade, write_kinect, write_video
from idfslam.datasets import open_recording
from idfslam.datasets.readers.azure_kinect import read_calibration
from idfslam.errors import RecordingError
from idfslam.geometry.camera import Camera


def test_colour_depth_camera_and_stamps(tmp_path: Path) -> None:
    """1280x720 shows rows 120 to 839 of a sensor of 1280x960: fx 0.46875 * 1280 = 600, fy 0.625 * 960 = 600; then half of all."""
    recording = open_recording(write_kinect(tmp_path / "room.mkv", calibration=kinect_calibration()))
    assert len(recording) == 3 and recording.name == "room" and recording.ground_truth is None
    assert recording.camera == Camera(640, 360, 300.0, 300.0, 319.5, 179.5)
    np.testing.assert_allclose(recording.timestamps, [0, 0.033, 0.067], atol=1e-9)
    for i in (2, 0, 1):
        frame = recording[i]
        np.testing.assert_allclose(frame.colour.mean((0, 1)) * 255, shade(i)[::-1], atol=4)
        # The depth camera, of 640x576 pixels and 512 px, sees 320/512 to each side and (575.5 - 331.5)/512 downwards: columns to 187.5 px
        # from the middle and rows to 143 px below it.
        seen = frame.depth > 0
        assert seen[:323, 132:507].all() and not seen[:, :131].any() and not seen[:, 508:].any() and not seen[323:].any()
        np.testing.assert_allclose(frame.depth[seen], 1 + i / 1000, rtol=1e-6)


def test_depth_is_moved_by_the_baseline(tmp_path: Path) -> None:
    """32 mm to the left in the colour camera's frame: 300 px * 0.032 m / 1 m = 9.6 px."""
    path = write_kinect(tmp_path / "room.mkv", calibration=kinect_calibration(t=(-0.032, 0.0, 0.0)))
    columns = np.flatnonzero((open_recording(path)[0].depth > 0).any(0))
    assert abs(columns[0] - (132.5 - 9.6)) <= 1 and abs(columns[-1] - (507.5 - 1 - 9.6)) <= 1


def test_distortion_of_both_cameras_is_taken_away(tmp_path: Path) -> None:
    """A ray that both distorted images show lands where the pinhole camera sees it."""
    calibration = kinect_calibration(distortion=True)
    ray, k = np.array([[[0.3, -0.2, 1.0]]]), np.array([0.5, -0.3, -1e-4, 2e-4, 0.1, 0.7, -0.1, 0.02])
    K = np.array([[512, 0, 319.5], [0, 512, 512 - 180 - 0.5], [0, 0, 1]])  # crop of 1024x1024 at (192, 180)
    u, v = cv2.projectPoints(ray, np.zeros(3), np.zeros(3), K, k)[0].ravel().round().astype(int)
    depth = np.zeros((576, 640), np.uint16)
    depth[v - 1 : v + 2, u - 1 : u + 2] = 2000
    recording = open_recording(write_kinect(tmp_path / "room.mkv", calibration=calibration, depth=depth))
    assert recording.camera == Camera(640, 360, 300.0, 300.0, 319.5, 179.5)
    rows, columns = np.nonzero(recording[0].depth)
    assert abs(columns.mean() - (319.5 + 0.3 * 300)) < 1 and abs(rows.mean() - (179.5 - 0.2 * 300)) < 1


@pytest.mark.parametrize(
    ("size", "depth", "colour_centre", "depth_centre", "depth_focal"),
    [
        ((1920, 1080), (640, 576), (959.5, 539.5), (319.5, 331.5), 512),
        ((2048, 1536), (320, 288), (1023.5, 767.5), (159.5, 165.5), 256),
        ((3840, 2160), (512, 512), (1919.5, 1079.5), (255.5, 255.5), 256),
        ((4096, 3072), (1024, 1024), (2047.5, 1535.5), (511.5, 511.5), 512),
    ],
)
def test_modes(size: tuple[int, int], depth: tuple[int, int], colour_centre: tuple, depth_centre: tuple, depth_focal: float) -> None:
    colour, beside = read_calibration(json.dumps(kinect_calibration(t=(0.1, 0.2, 0.3))).encode(), size, depth, "test")
    assert (colour.cx, colour.cy) == colour_centre and colour.fx == pytest.approx(0.46875 * size[0]) == pytest.approx(colour.fy)
    assert (beside.calibration.cx, beside.calibration.cy) == depth_centre
    assert beside.calibration.fx == beside.calibration.fy == depth_focal
    assert beside.T_colour_depth[:3, 3].tolist() == [0.1, 0.2, 0.3]


def test_a_stated_delay_of_the_depth(tmp_path: Path) -> None:
    """Depth 30 ms after its colour: nearer to the next colour image, and yet paired with its own."""
    recording = open_recording(write_kinect(tmp_path / "room.mkv", calibration=kinect_calibration(), delay=0.03))
    assert len(recording) == 3
    frame = recording[1]
    np.testing.assert_allclose(frame.depth[180, 320], 1.001, rtol=1e-6)
    np.testing.assert_allclose(frame.colour.mean((0, 1)) * 255, shade(1)[::-1], atol=4)


def test_the_users_camera_is_that_of_the_video(tmp_path: Path) -> None:
    path = write_kinect(tmp_path / "room.mkv", calibration=kinect_calibration(), frames=1)
    recording = open_recording(path, camera={"fx": 610.0, "fy": 612.0, "cx": 639.5, "cy": 359.5})
    assert recording.camera == Camera(640, 360, 305.0, 306.0, 319.5, 179.5)


def refuses(path: Path, message: str) -> None:
    with pytest.raises(RecordingError, match=message) as caught:
        open_recording(path)
    assert "\n" not in str(caught.value)


def test_what_is_wrong(tmp_path: Path) -> None:
    refuses(write_kinect(tmp_path / "a.mkv", frames=1), r"colour 1280x720, depth 640x576 and no calibration\.json attached")
    refuses(
        write_kinect(tmp_path / "b.mkv", frames=1, calibration={"CalibrationInformation": {}}),
        "no 'Cameras', expected the calibration of an Azure Kinect",
    )
    small = np.full((100, 90), 1000, np.uint16)
    refuses(
        write_kinect(tmp_path / "c.mkv", frames=1, calibration=kinect_calibration(), depth=small), "Azure Kinect for depth images of 90x100"
    )
    refuses(write_video(tmp_path / "d.mkv", codec="mjpeg"), "video tracks yuvj420p, expected colour and 16-bit grey depth")
    (tmp_path / "e.mkv").write_bytes(write_kinect(tmp_path / "a.mkv", frames=1).read_bytes()[:50])
    refuses(tmp_path / "e.mkv", "not a readable video")


def test_a_recording_that_was_cut_off(tmp_path: Path) -> None:
    path = write_kinect(tmp_path / "room.mkv", calibration=kinect_calibration(), frames=6)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    recording = open_recording(path)
    assert 1 <= len(recording) < 6
    np.testing.assert_allclose(recording[0].depth[180, 320], 1.0, rtol=1e-6)
