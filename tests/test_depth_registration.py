"""Depth registered to the colour camera: exact pixels and values, holes, occlusion, distortion; and a plain folder that asks for it."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.recordings import write_folder
from idfslam.datasets import open_recording
from idfslam.datasets.cameras.calibration import Calibration, DepthCameraCalibration
from idfslam.datasets.images.depth_registration import DepthRegistration
from idfslam.errors import RecordingError
from idfslam.geometry.camera import Camera

COLOUR = Camera(20, 10, 10.0, 10.0, 9.5, 4.5)
SAME = Calibration(10.0, 10.0, 9.5, 4.5)


def translated(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def register(raw: np.ndarray, T: np.ndarray, *, depth: Calibration = SAME, colour: Camera = COLOUR, scale: float = 1000) -> np.ndarray:
    return DepthRegistration(DepthCameraCalibration(depth, T), (raw.shape[1], raw.shape[0]), colour, scale, "test")(raw)


def test_the_same_camera_at_the_same_place_changes_nothing() -> None:
    raw = np.arange(500, 700, dtype=np.uint16).reshape(10, 20)
    raw[3, 4], raw[5, 6] = 0, 65535
    expected = np.where(raw == 65535, 0, raw)
    np.testing.assert_allclose(register(raw, np.eye(4)), expected, rtol=1e-6)


def test_a_shift_moves_the_near_further_than_the_far() -> None:
    """Baseline 0.2 m, focal length 10 px: 2 px at 1 m, 4 px at 0.5 m; z stays."""
    raw = np.full((10, 20), 1000, np.uint16)
    raw[:, 8:12] = 500
    out = register(raw, translated(0.2))
    assert (out[:, :2] == 0).all()  # beyond the left edge of what the depth camera sees
    assert (out[:, 2:10] == 1000).all()  # columns 0-7, moved by 2
    assert (out[:, 10:12] == 0).all()  # behind the near box, as the depth camera sees it: no reading is invented
    assert (out[:, 12:16] == 500).all()  # columns 8-11, moved by 4, over the background's 14 and 15
    assert (out[:, 16:] == 1000).all()


def test_a_step_forward_shortens_the_depth() -> None:
    out = register(np.full((10, 20), 1000, np.uint16), translated(0, 0, -0.5))
    assert set(np.unique(out)) == {500.0}  # twice as near: the middle of the image fills all of it


def test_translations_are_in_metres_whatever_the_units() -> None:
    out = register(np.full((10, 20), 5000, np.uint16), translated(0.2), scale=5000)
    assert (out[:, :2] == 0).all() and (out[:, 2:] == 5000).all()


def test_fewer_depth_pixels_leave_no_holes_and_make_no_new_values() -> None:
    """A third of the pixels: each reading covers 3 x 3."""
    small = Calibration(10 / 3, 10 / 3, (9.5 + 0.5) / 3 - 0.5, (4.5 + 0.5) / 3 - 0.5)
    colour = Camera(18, 9, 10.0, 10.0, 9.5, 4.5)
    raw = np.arange(1000, 1018, dtype=np.uint16).reshape(3, 6)
    np.testing.assert_allclose(register(raw, np.eye(4), depth=small, colour=colour), np.kron(raw, np.ones((3, 3))), rtol=1e-6)


def test_a_quarter_turn_about_the_axis() -> None:
    T = np.eye(4)
    T[:2, :2] = [[0, -1], [1, 0]]  # x of depth is y of colour, y of depth is -x of colour
    square = Camera(9, 9, 10.0, 10.0, 4.0, 4.0)
    raw = np.zeros((9, 9), np.float32)
    raw[4, 6] = 2.0  # to the right in depth ...
    out = register(raw, T, depth=Calibration(10.0, 10.0, 4.0, 4.0), colour=square, scale=1)
    assert out[6, 4] == 2.0 and np.count_nonzero(out) == 1  # ... is below in colour


def test_distortion_of_the_depth_camera_is_taken_away() -> None:
    """A reading lies where the pinhole camera sees its ray, though the depth image shows it elsewhere."""
    k = (0.3, -0.1, 0.002, -0.001, 0.05, 0.02, 0.01, 0.03)
    camera = Camera(200, 160, 150.0, 150.0, 99.5, 79.5)
    point = np.array([[[0.4, -0.3, 1.0]]])
    u, v = cv2.projectPoints(point, np.zeros(3), np.zeros(3), camera.matrix().numpy(), np.array(k))[0].ravel()
    raw = np.zeros((160, 200), np.uint16)
    raw[round(v), round(u)] = 1000
    assert (round(u), round(v)) == (163, 32)
    out = register(raw, np.eye(4), depth=Calibration(150.0, 150.0, 99.5, 79.5, distortion=k), colour=camera)
    rows, columns = np.nonzero(out)
    assert abs(columns.mean() - (0.4 * 150 + 99.5)) < 1 and abs(rows.mean() - (-0.3 * 150 + 79.5)) < 1  # (159.5, 34.5)


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.2, 0.2), st.floats(0.5, 3))
def test_a_plane_stays_a_plane(x: float, y: float, z: float, distance: float) -> None:
    out = register(np.full((10, 20), distance, np.float32), translated(x, y, z), scale=1)
    np.testing.assert_allclose(out[out > 0], distance + z, rtol=1e-5)


def write_beside(path: Path, **changes: object) -> Path:
    """A folder whose depth camera stands 2/15 m to the right of the colour camera: 2 px at 1 m with 15 px of focal length."""
    camera = {"w": 16, "h": 12, "fx": 15, "fy": 15, "cx": 7.5, "cy": 5.5, "scale": 1000}
    values = {"camera": camera, "depth_camera": camera, "T_colour_depth": translated(2 / 15).tolist()} | changes
    write_folder(path)
    (path / "cam_params.json").write_text(json.dumps(values))
    return path


def test_a_folder_says_where_its_depth_camera_stands(tmp_path: Path) -> None:
    frame = open_recording(write_beside(tmp_path / "room"))[0]
    assert frame.camera == Camera(16, 12, 15.0, 15.0, 7.5, 5.5)
    assert (frame.depth[:, :2] == 0).all() and frame.depth[0, 2] == 0  # its first pixel has no reading
    np.testing.assert_allclose(frame.depth[1:, 2:], 1.0, rtol=1e-6)


def test_a_depth_image_of_another_size_than_colour(tmp_path: Path) -> None:
    half = {"w": 8, "h": 6, "fx": 7.5, "fy": 7.5, "cx": 3.5, "cy": 2.5, "scale": 500}
    path = write_beside(tmp_path / "room", depth_camera=half, T_colour_depth=np.eye(4).tolist())
    for file in (path / "depth").iterdir():
        assert cv2.imwrite(str(file), np.full((6, 8), 1000, np.uint16))
    np.testing.assert_allclose(open_recording(path)[0].depth, 2.0)  # 1000 units of 1/500 m, on all of the 16 x 12 pixels


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"T_colour_depth": [[1, 2], [3, 4]]}, "rigid 4x4 matrix, depth to colour"),
        ({"T_colour_depth": (2 * np.eye(4)).tolist()}, "rigid 4x4 matrix, depth to colour"),
        ({"T_colour_depth": None}, "rigid 4x4 matrix, depth to colour"),
        ({"depth_camera": {"fx": 15}}, "no 'fy'"),
        ({"depth_camera": {"w": 8, "h": 6, "fx": 15, "fy": 15, "cx": 3, "cy": 3}}, "images are 16x12, but .* is for 8x6"),
    ],
)
def test_a_depth_camera_that_cannot_be(changes: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=message) as caught:
        open_recording(write_beside(tmp_path / "room", **changes))
    assert "\n" not in str(caught.value)


def test_calibrations_follow_the_size_of_the_images() -> None:
    """Pixel centres at integers: halving an image moves its middle from 9.5 to 4.5."""
    assert SAME.resized((20, 10), (10, 5)) == replace(SAME, fx=5.0, fy=5.0, cx=4.5, cy=2.0, width=10, height=5)
    assert Calibration(depth_scale=5).resized((20, 10), (10, 5)) == Calibration(depth_scale=5)
