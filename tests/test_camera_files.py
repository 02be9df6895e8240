"""The camera is read from files in the forms that people have; what files state wins over formats and publications."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from helpers.recordings import HEIGHT, WIDTH, write_cam_params, write_folder, write_replica, write_sens, write_seven_scenes, write_tum
from idfslam.datasets import open_recording
from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.cameras.camera_files import read_beside
from idfslam.datasets.cameras.camera_json import read_camera_json
from idfslam.datasets.cameras.camera_text import parse_camera
from idfslam.datasets.provenance import provenance
from idfslam.datasets.recording_path import absolute, names
from idfslam.errors import RecordingError
from idfslam.geometry.camera import Camera
from idfslam.sensing.depth_deformation import DepthDeformation

PINHOLE = (527.21, 526.5, 322.25, 238.73)
LENS = (0.1, -0.2, 0.001, -0.002, 0.05)
RATIONAL = (*LENS, 0.1, -0.2, 0.01)


def values(camera: Calibration) -> tuple[float | None, ...]:
    return camera.fx, camera.fy, camera.cx, camera.cy


FORMS = {
    "matrix": "527.21 0 322.25\n0 526.5 238.73\n0 0 1\n",
    "with a comment": "# K\n527.21 0 322.25 // first row\n0 526.5 238.73\n0 0 1\n",
    "commas": "527.21, 0, 322.25\n0, 526.5, 238.73\n0, 0, 1\n",
    "only commas": "527.21,0,322.25\n0,526.5,238.73\n0,0,1",
    "brackets": "[[527.21, 0, 322.25],\n [0, 526.5, 238.73],\n [0, 0, 1]]\n",
    "on one line": "[[527.21, 0, 322.25], [0, 526.5, 238.73], [0, 0, 1]]",
    "Python": "K = np.array([[527.21, 0, 322.25],\n [0, 526.5, 238.73],\n [0, 0, 1]])\n",
    "MATLAB": "K = [527.21 0 322.25; 0 526.5 238.73; 0 0 1];",
    "by columns": "527.21 0 0\n0 526.5 0\n322.25 238.73 1\n",
    "by columns on one line": "527.21 0 0 0 526.5 0 322.25 238.73 1",
    "rounding": "527.21 1e-13 322.25\n0 526.5 238.73\n0 0 1\n",
    "tiny skew": "527.21 0.03 322.25\n0 526.5 238.73\n0 0 1\n",
    "four lines": "527.21\n526.5\n322.25\n238.73\n",
    "nine lines": "527.21\n0\n322.25\n0\n526.5\n238.73\n0\n0\n1\n",
    "keys": "fx: 527.21\nfy: 526.5\ncx: 322.25\ncy: 238.73\n",
    "equal signs": "fx = 527.21, fy = 526.5, cx = 322.25, cy = 238.73\n",
    "keys and decimal commas": "fx: 527,21\nfy: 526,5\ncx: 322,25\ncy: 238,73\n",
    "decimal commas": "527,21 0 322,25\n0 526,5 238,73\n0 0 1\n",
    "decimal commas and semicolons": "527,21;0;322,25\n0;526,5;238,73\n0;0;1\n",
    "decimal commas in one line": "527,21 526,5 322,25 238,73\n",
    "decimal commas in four lines": "527,21\n526,5\n322,25\n238,73\n",
    "semicolons": "527.21;0;322.25\n0;526.5;238.73\n0;0;1\n",
    "tabs": "527.21\t0\t322.25\n0\t526.5\t238.73\n0\t0\t1\n",
    "3x4": "527.21 0 322.25 0\n0 526.5 238.73 0\n0 0 1 0\n",
    "4x4": "527.21 0 322.25 0\n0 526.5 238.73 0\n0 0 1 0\n0 0 0 1\n",
    "3x4 on one line": "527.21 0 322.25 0 0 526.5 238.73 0 0 0 1 0",
    "nine numbers": "527.21 0 322.25 0 526.5 238.73 0 0 1\n",
    "sixteen numbers": "527.21 0 322.25 0 0 526.5 238.73 0 0 0 1 0 0 0 0 1\n",
    "a name before them": "K: 527.21 0 322.25 0 526.5 238.73 0 0 1\n",
    "KITTI": "P_rect: 5.2721e+02 0 3.2225e+02 0 0 5.265e+02 2.3873e+02 0 0 0 1 0\n",
    "columns with names": "fx,fy,cx,cy\n527.21,526.5,322.25,238.73\n",
    "columns with names and spaces": "fx fy cx cy\n527.21 526.5 322.25 238.73\n",
    "keys without signs": "fx 527.21\nfy 526.5\ncx 322.25\ncy 238.73\n",
    "a line": "527.21 526.5 322.25 238.73",
    "no line end, exponent": "5.2721e2 5.265E+2 3.2225e2 2.3873e2",
}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_same_camera(form: str) -> None:
    camera = parse_camera(FORMS[form], "K.txt")
    assert values(camera) == pytest.approx(PINHOLE)
    assert (camera.width, camera.height, camera.distortion, camera.source) == (None, None, None, "K.txt")


@pytest.mark.parametrize(
    "text",
    [
        "640 480 527.21 526.5 322.25 238.73\n",
        "527.21 526.5 322.25 238.73 640 480\n",
        "640 480\n527.21 526.5 322.25 238.73\n",
        "width: 640\nheight: 480\nfx: 527.21\nfy: 526.5\ncx: 322.25\ncy: 238.73\n",
        "1 PINHOLE 640 480 527.21 526.5 322.75 239.23\n",  # COLMAP counts pixel centres from 0.5
        "# Camera list\n3 OPENCV 640 480 527.21 526.5 322.75 239.23 0 0 0 0\n",
    ],
)
def test_the_image_size_is_understood(text: str) -> None:
    camera = parse_camera(text, "K.txt")
    assert values(camera) == pytest.approx(PINHOLE)
    assert (camera.width, camera.height, camera.distortion) == (640, 480, None)


@pytest.mark.parametrize("lens", [LENS[:4], LENS, RATIONAL])
def test_distortion_follows_the_camera(lens: tuple[float, ...]) -> None:
    line, matrix = " ".join(map(str, PINHOLE)), FORMS["matrix"]
    tail = " ".join(map(str, lens))
    for text in (f"{line} {tail}", f"{line}\n{tail}", f"{matrix}{tail}\n", f"640 480 {line} {tail}"):
        camera = parse_camera(text, "K.txt")
        assert values(camera) == pytest.approx(PINHOLE)
        assert camera.distortion == lens


def test_one_focal_length_is_that_of_both_axes() -> None:
    assert values(parse_camera("focal_length: 500\ncx: 320\ncy: 240", "K.txt")) == (500, 500, 320, 240)


@given(st.text("0123456789.,;-+eE[]{}():=\n\t fxyckKpwidth#\"'P", max_size=200))
@example("\n" * 100_000)
@example("1 " * 50_000)
@example("K:" * 50_000)
def test_no_text_is_more_than_refused(text: str) -> None:
    try:
        parse_camera(text, "K.txt")
    except RecordingError as error:
        assert "\n" not in str(error)


def test_orb_slam_s_settings() -> None:
    text = """%YAML:1.0
Camera.type: "PinHole"
Camera.fx: 527.21
Camera.fy: 526.5
Camera.cx: 322.25
Camera.cy: 238.73
Camera.k1: 0.1
Camera.k2: -0.2
Camera.p1: 0.001
Camera.p2: -0.002
Camera.k3: 0.05
Camera.width: 640
Camera.height: 480
Camera.fps: 30.0
Camera.bf: 40.0
DepthMapFactor: 5000.0
"""
    assert parse_camera(text, "tum.yaml") == Calibration(*PINHOLE, 640, 480, LENS, 5000.0, source="tum.yaml")


ROS = """image_width: 640
image_height: 480
camera_name: kinect
camera_matrix:
  rows: 3
  cols: 3
  data: [527.21, 0., 322.25, 0., 526.5, 238.73, 0., 0., 1.]
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.1, -0.2, 0.001, -0.002, 0.05]
rectification_matrix:
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
"""


def test_ros_camera_info() -> None:
    assert parse_camera(ROS.replace("{model}", "plumb_bob"), "ost.yaml") == Calibration(*PINHOLE, 640, 480, LENS, source="ost.yaml")
    with pytest.raises(RecordingError, match=r"ost.yaml: a fisheye lens, expected k1 k2 p1 p2 .* of a pinhole: rectify the images first"):
        parse_camera(ROS.replace("{model}", "equidistant"), "ost.yaml")


def test_opencv_s_file() -> None:
    head = "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
    text = "   data: [ 527.21, 0.,\n       322.25, 0., 526.5, 238.73, 0., 0., 1. ]\n"
    assert values(parse_camera(head + text, "c.yaml")) == pytest.approx(PINHOLE)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no numbers, expected a 3x3 matrix"),
        ("527", "1 number, expected a 3x3 matrix or one line of fx fy cx cy"),
        ("527.21 0 322.25\n0 526.5 238.73\n", r"2 rows of \[3\] numbers, expected a 3x3 matrix"),
        ("527.21 5 322.25\n0 526.5 238.73\n0 0 1\n", "a skew of 5 px, expected fx 0 cx in the first row"),
        ("527.21 0 322.25\n0 526.5 238.73\n0 0 2\n", "not a pinhole matrix, expected rows fx 0 cx"),
        ("527.21 0 nan\n0 526.5 238.73\n0 0 1\n", "not a pinhole matrix"),
        ("fx: 527.21\ncx: 322.25", "fy, cy missing, expected"),
        ("see page 3", "could not convert string to float: 'see', expected a 3x3 matrix"),
        ("see the paper", "no numbers, expected a 3x3 matrix"),
        ("fx: 1\nfy: 1\ncx: 1\ncy: 1\nwidth: 1e400", "cannot convert float infinity to integer, expected a 3x3 matrix"),
        ("1 OPENCV_FISHEYE 640 480 1 2 3 4 5 6 7 8", "a camera of model OPENCV_FISHEYE, expected SIMPLE_PINHOLE, PINHOLE"),
        ("1 OPENCV 640 480 1 2 3 4", "4 values of model OPENCV, expected more"),
        ("1 PINHOLE 640 480 1 2 3 4\n2 PINHOLE 640 480 1 2 3 5", "2 cameras, expected one for all images"),
    ],
)
def test_what_is_no_camera_is_refused_in_one_line(text: str, message: str) -> None:
    with pytest.raises(RecordingError, match=f"^K.txt: {message}") as caught:
        parse_camera(text, "K.txt")
    assert "\n" not in str(caught.value)


# ----- JSON


def test_open3d_s_matrix_is_stored_by_columns(tmp_path: Path) -> None:
    path = tmp_path / "camera_intrinsic.json"
    fx, fy, cx, cy = PINHOLE
    path.write_text(json.dumps({"width": 640, "height": 480, "intrinsic_matrix": [fx, 0, 0, 0, fy, 0, cx, cy, 1]}))
    expected = Calibration(*PINHOLE, 640, 480, source=str(path))
    assert read_camera_json(path) == read_beside(tmp_path) == expected
    path.write_text(
        json.dumps({"width": 640, "height": 480, "depth_scale": 0.001, "intrinsic_matrix": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]})
    )
    assert read_camera_json(path) == Calibration(*PINHOLE, 640, 480, depth_scale=1000, source=str(path))


def test_every_json_file_may_state_times_and_a_deformation_of_depth(tmp_path: Path) -> None:
    path = tmp_path / "camera_intrinsic.json"
    fx, fy, cx, cy = PINHOLE
    matrix = {"width": 640, "height": 480, "intrinsic_matrix": [fx, 0, 0, 0, fy, 0, cx, cy, 1]}
    path.write_text(json.dumps({"camera": {**matrix, "readout": 0.02, "depth_deformation": {"range": 0.01}}}))
    found = read_camera_json(path)
    assert values(found) == PINHOLE
    assert (found.readout, found.deformation) == (0.02, DepthDeformation(range=0.01))


def test_cam_params_without_an_outer_name(tmp_path: Path) -> None:
    (tmp_path / "cam_params.json").write_text(json.dumps({"w": 640, "h": 480, "fx": 1, "fy": 2, "cx": 3, "cy": 4, "scale": 5}))
    assert read_beside(tmp_path) == Calibration(1, 2, 3, 4, 640, 480, None, 5, source=str(tmp_path / "cam_params.json"))


def test_other_names_in_json(tmp_path: Path) -> None:
    path = tmp_path / "intrinsics.json"
    fx, fy, cx, cy = PINHOLE
    inner = {"width": 640, "height": 480, "fx": fx, "fy": fy, "ppx": cx, "ppy": cy, "coeffs": LENS}
    path.write_text(json.dumps({"color": inner}), encoding="utf-8-sig")
    assert read_camera_json(path) == Calibration(*PINHOLE, 640, 480, LENS, source=str(path))


HUGE = '{"fx": ' + "9" * 400 + ', "fy": 1, "cx": 1, "cy": 1}'


@pytest.mark.parametrize("text", ["[]", "{", "{}", '{"intrinsic_matrix": [1, 2]}', '{"fx": 1e999999}', "[" * 100000, HUGE])
def test_json_without_a_camera_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "camera_intrinsic.json"
    path.write_text(text)
    with pytest.raises(RecordingError, match="expected width, height and intrinsic_matrix of 9 numbers, or fx, fy, cx, cy"):
        read_camera_json(path)


# ----- precedence


STATED = Camera(WIDTH, HEIGHT, 20.0, 20.0, 7.0, 5.0)


@pytest.mark.parametrize("write", [write_replica, write_seven_scenes, write_tum])
@pytest.mark.parametrize("name", ["intrinsics.txt", "camera-intrinsics.txt", "camera.yaml"])
def test_what_a_file_states_wins_over_the_publication(write, name: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    path = write(tmp_path / "rgbd_dataset_freiburg1_chess", cam_params=False)
    (path / name).write_text("20 0 7\n0 20 5\n0 0 1")
    recording = open_recording(path)
    assert recording.camera == STATED
    found = provenance(recording)
    assert found is not None and found.camera == str(path / name)


def test_cam_params_win_over_intrinsics_and_flags_over_both(tmp_path: Path) -> None:
    path = write_seven_scenes(tmp_path / "chess")
    (path / "intrinsics.txt").write_text("20 0 7\n0 20 5\n0 0 1")
    assert open_recording(path).camera.fx == 15
    flags = {"fx": 20.0, "fy": 20.0, "cx": 7.0, "cy": 5.0}
    assert open_recording(path, camera=flags).camera == STATED


def test_a_file_in_the_folder_wins_over_the_format_s_own_camera(tmp_path: Path) -> None:
    path = write_sens(tmp_path / "scene.sens")
    assert open_recording(path).camera.fx == 15
    (tmp_path / "calib.txt").write_text("of something else")  # beside a file it may be of another recording
    assert open_recording(path).camera.fx == 15
    (tmp_path / "calib.txt").unlink()
    (tmp_path / "intrinsics.txt").write_text("20 0 7\n0 20 5\n0 0 1")
    assert open_recording(path).camera == open_recording(tmp_path).camera == STATED


def test_a_published_camera_says_so_and_a_guess_by_the_name_too(tmp_path: Path) -> None:
    size = (640, 480)
    for name, said in (
        ("rgbd_dataset_freiburg1_desk", "the published camera of TUM freiburg1"),
        ("my_freiburg1_kitchen", "the published camera of TUM freiburg1, guessed from the folder's name my_freiburg1_kitchen"),
    ):
        path = write_tum(tmp_path / name, frames=1, size=size, cam_params=False)
        found = provenance(open_recording(path))
        assert found is not None and (found.camera, found.depth) == (said, "TUM layout")
    seven = provenance(open_recording(write_seven_scenes(tmp_path / "chess", frames=1, size=size, cam_params=False)))
    assert seven is not None and (seven.camera, seven.depth_scale, seven.depth) == (
        "the published camera of 7-Scenes",
        1000,
        "7-Scenes layout",
    )


def test_a_link_goes_by_both_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = write_tum(tmp_path / "rgbd_dataset_freiburg2_desk", frames=1, size=(640, 480), cam_params=False)
    other = write_tum(tmp_path / "kitchen", frames=1, size=(640, 480), cam_params=False)
    (tmp_path / "desk").symlink_to(target)
    (tmp_path / "rgbd_dataset_freiburg3_office").symlink_to(other)
    assert open_recording(tmp_path / "desk").camera.fx == 520.9
    assert open_recording(tmp_path / "desk").name == "desk"
    assert open_recording(tmp_path / "rgbd_dataset_freiburg3_office").camera.fx == 535.4
    assert names(tmp_path / "desk") == ("desk", "rgbd_dataset_freiburg2_desk")
    monkeypatch.chdir(target / "rgb")
    assert absolute("..") == target
    monkeypatch.chdir(target)
    assert absolute(".") == target


# ----- cameras that cannot be


def refusal(path: Path, text: str) -> str:
    (path / "intrinsics.txt").write_text(text)
    with pytest.raises(RecordingError) as caught:
        open_recording(path)
    return str(caught.value)


def test_the_likely_cause_of_an_impossible_camera_is_named(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room")
    assert refusal(path, "30 0 16\n0 30 12\n0 0 1").endswith(
        "lies outside the 16x12 images: the camera is probably of 32x24 images; "
        "then give --camera.fx 15.0 --camera.fy 15.0 --camera.cx 7.8 --camera.cy 5.8"
    )
    assert "in fractions of the image, expected pixels: give --camera.fx 12.8 --camera.fy 12.0 --camera.cx 7.5 --camera.cy 5.5" in refusal(
        path, "0.8 0 0.5\n0 1 0.5\n0 0 1"
    )
    assert "says distortion nan 0 0 0: expected finite numbers" in refusal(path, "15 15 7 5 nan 0 0 0")
    assert "is for 32x24: give cam_params.json in the recording or " in refusal(path, "32 24 30 30 15.5 11.5")
    assert refusal(path, "32 24 30 30 15.5 11.5").endswith(
        "of these images (if they were only resized: --camera.fx 15.0 --camera.fy 15.0 --camera.cx 7.5 --camera.cy 5.5)"
    )


def test_files_with_a_byte_order_mark_are_read(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room")
    (path / "intrinsics.txt").write_text("20 0 7\n0 20 5\n0 0 1", encoding="utf-16")
    assert open_recording(path).camera == STATED
    write_cam_params(path, (WIDTH, HEIGHT), 1000)
    text = (path / "cam_params.json").read_text()
    (path / "cam_params.json").write_text(text, encoding="utf-8-sig")
    assert open_recording(path).camera.fx == 15
    np.testing.assert_allclose(open_recording(path)[0].depth[6, 8], 1.0)


@pytest.mark.parametrize("name", ["depth_scale", "depth_factor", "png_depth_scale", "integer_depth_scale", "DepthMapFactor", "scale"])
@pytest.mark.parametrize("value", [5000, 0.0002])
def test_depth_scales_are_believed_under_the_names_that_programs_give_them(name: str, value: float, tmp_path: Path) -> None:
    camera = {"fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0}
    key = name.lower()
    forms = {
        "intrinsics.txt": "\n".join(f"{k}: {v}" for k, v in {**camera, name: value}.items()),
        "camera_intrinsic.json": json.dumps({**camera, key: value}),
        "camera.json": json.dumps({"color": camera, key: value}),
        "cam_params.json": json.dumps({"camera": {**camera, key: value}}),
    }
    for file, text in forms.items():
        folder = tmp_path / file.split(".")[0]
        folder.mkdir()
        (folder / file).write_text(text)
        assert read_beside(folder).depth_scale == pytest.approx(5000), file


def test_cam_params_may_have_the_form_of_other_programs(tmp_path: Path) -> None:
    values = {"width": 640, "height": 480, "intrinsic_matrix": [500, 0, 0, 0, 500, 0, 320, 240, 1], "depth_scale": None}
    (tmp_path / "cam_params.json").write_text(json.dumps(values))
    found = read_beside(tmp_path)
    assert (found.fx, found.cx, found.cy, found.width, found.depth_scale) == (500, 320, 240, 640, None)


def test_the_export_of_rtab_map(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "scan")
    text = parse_camera((folder / "intrinsics.txt").read_text(), "")
    (folder / "intrinsics.txt").unlink()
    (folder / "calib").mkdir()
    for i in range(3):
        numbers = f"{text.fx}, 0., {text.cx}, 0., {text.fy}, {text.cy}, 0., 0., 1."
        yaml = f"image_width: {WIDTH}\nimage_height: {HEIGHT}\ncamera_matrix:\n   rows: 3\n   cols: 3\n   data: [ {numbers} ]\n"
        transform = "local_transform:\n   rows: 3\n   cols: 4\n   data: [ 0., 0., 1., 0., -1., 0., 0., 0., 0., -1., 0., 0. ]\n"
        (folder / f"calib/{i}.yaml").write_text(f"%YAML:1.0\n---\n{yaml}{transform}")
    recording = open_recording(folder)
    assert (recording.camera.fx, recording.camera.cy) == (text.fx, text.cy)
    found = provenance(recording)
    assert found is not None and found.camera == str(folder / "calib/0.yaml")
