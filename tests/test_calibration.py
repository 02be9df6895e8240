"""Calibration of recordings: the camera file that it writes, and the camera that it finds on a generated recording."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.point_problem import CAMERA, values
from idfslam.adjustment.camera_findings import doubts, findings
from idfslam.adjustment.camera_model import NAMES, CameraModel
from idfslam.adjustment.self_calibration import CameraEstimate, confirmed, fitting
from idfslam.adjustment.sensor_times import SensorTime
from idfslam.cli.command_line import main
from idfslam.config import FAST
from idfslam.datasets import open_recording
from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.cameras.camera_files import read_given
from idfslam.datasets.provenance import Provenance
from idfslam.datasets.recalibrated import Recalibrated
from idfslam.errors import ConfigError, RecordingError
from idfslam.frame import FPS, Frame
from idfslam.geometry.sensor_timing import SensorTiming
from idfslam.geometry.trajectory import Trajectory
from idfslam.runs.calibrated_camera import camera_values, combined_lens, write_camera
from idfslam.runs.calibration import calibrate_from, with_own_camera
from idfslam.runs.calibration_keyframes import Keyframes, rectified_keyframe, row_times, stretch_around
from idfslam.runs.run_config import RecordingSource
from idfslam.sensing.depth_deformation import DepthDeformation


def estimate(sigma: float = 1e-4, **deviations: float) -> CameraEstimate:
    """An estimate whose values all have one standard deviation, but for the scale of depth, which is not determined."""
    of = np.array([0.0 if name == "depth_scale" else sigma for name in NAMES])
    return CameraEstimate(CameraModel(CAMERA, values(**deviations)), np.diag(of**2), [], 500, 2000, 0.2)


# What is told


def test_a_camera_that_fits_has_no_doubts() -> None:
    assert doubts(estimate(focal=0.0003, cx=0.0005, k1=0.001, across=0.001)) == []


def test_what_is_certain_and_matters_is_doubted() -> None:
    assert doubts(estimate(focal=1 / 1.04 - 1)) == ["the focal length looks 4.0 % too long"]
    assert doubts(estimate(focal=1 / 0.9 - 1)) == ["the focal length looks 10.0 % too short"]
    assert doubts(estimate(cx=0.02)) == ["the principal point looks 6.4 px off"]
    assert doubts(estimate(across2=-0.015, along2=-0.015)) == ["depth looks warped by 3.0 %"]


def test_what_is_not_certain_is_not_doubted() -> None:
    assert doubts(estimate(sigma=0.02, focal=0.04)) == []


def test_what_is_not_determined_says_how_to_determine_it() -> None:
    nothing = replace(estimate(), covariance=np.zeros((len(NAMES), len(NAMES))))
    assert [finding.found for finding in findings(nothing)] == ["not determined"] * 5
    assert all(":" in finding.meaning for finding in findings(nothing))


def test_stated_values_that_fit_stay() -> None:
    """The distortion fits as stated. The focal length does not; it is correlated with the distortion and moves with it."""
    at = estimate(focal=0.02, cx=2.5e-4, k1=1.5e-4)
    C = at.covariance.copy()
    C[NAMES.index("k1"), NAMES.index("focal")] = C[NAMES.index("focal"), NAMES.index("k1")] = 0.4 * 1e-8
    found = replace(at, covariance=C)
    assert fitting(found) == ["depth over range and image", "distortion", "principal point"]
    kept = confirmed(found).values
    assert kept[NAMES.index("cx")] == kept[NAMES.index("k1")] == 0
    assert kept[NAMES.index("focal")] == pytest.approx(0.02 - 0.4 * 1.5e-4)
    assert "it stays" in findings(found)[1].meaning


# The file


def test_the_file_is_read_as_the_camera_that_was_found(tmp_path: Path) -> None:
    model = CameraModel(CAMERA, values(focal=0.01, cx=0.01, k1=0.05, depth_scale=0.02, range=0.004))
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"camera": camera_values(model, CAMERA, Provenance("x", depth_scale=1000.0))}))
    found = read_given(path)
    assert (found.fx, found.cx) == pytest.approx((model.camera.fx, model.camera.cx))
    assert (found.width, found.height) == (320, 240)
    assert found.depth_scale == pytest.approx(1000 / model.depth_factor)
    assert found.distortion == (0.05, 0.0, 0.0, 0.0)
    assert found.deformation == model.deformation


def test_a_resized_recording_has_a_file_for_its_own_images() -> None:
    found = camera_values(CameraModel.as_stated(CAMERA), CAMERA, Provenance("x", size=(640, 480)))
    assert found["w"] == 640
    assert found["fx"] == pytest.approx(580.0)
    assert found["cx"] == pytest.approx(158.5 * 2 - 0.5)


def test_a_second_calibration_adds_to_the_deformation_of_the_first() -> None:
    model = CameraModel(CAMERA, values(across=0.002))
    found = camera_values(model, CAMERA, Provenance("x", deformation=DepthDeformation(range=0.01, across=0.001)))
    assert found["depth_deformation"]["across"] == pytest.approx(0.003)
    assert found["depth_deformation"]["range"] == pytest.approx(0.01)


def test_distortion_of_two_lenses_combined_lens() -> None:
    """The images were undistorted with k1 = 0.1, and then 0.02 more was found, with another focal length and centre."""
    model = CameraModel(CAMERA, values(focal=0.01, cx=0.005, k1=0.02))
    camera, lens = combined_lens((0.1, -0.05, 0.001, 0.0), CAMERA, model)
    rays = np.array([[0.4, 0.3, 1.0], [-0.5, 0.1, 1.0], [0.0, 0.0, 1.0]])
    half = model.project(rays)[0]
    seen = np.concatenate([(half - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy], np.ones((3, 1))], 1)
    zero = np.zeros(3)
    expected = cv2.projectPoints(seen, zero, zero, CAMERA.matrix().numpy(), np.array([0.1, -0.05, 0.001, 0.0]))[0][:, 0]
    found = cv2.projectPoints(rays, zero, zero, camera.matrix().numpy(), np.array(lens))[0][:, 0]
    np.testing.assert_allclose(found, expected, atol=0.02)


@pytest.mark.parametrize("deformation", [{"depth": 0.1}, {"range": "far"}, {"range": 0.5}, [0.1]])
def test_a_damaged_deformation_is_one_line(tmp_path: Path, deformation: object) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"camera": {"fx": 290, "fy": 290, "cx": 160, "cy": 120, "depth_deformation": deformation}}))
    with pytest.raises(RecordingError, match=r"depth_deformation|could not convert|expected"):
        read_given(path)


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such file, expected a camera"):
        read_given(tmp_path / "camera.json")
    with pytest.raises(RecordingError, match="is a folder, expected the file of a camera"):
        read_given(tmp_path)


# Recordings read with it


def test_a_folder_is_read_with_the_file(box_recording: Path, tmp_path: Path) -> None:
    plain = open_recording(box_recording)
    c = plain.camera
    path = tmp_path / "other.json"
    camera = {"fx": c.fx * 1.1, "fy": c.fy, "cx": c.cx, "cy": c.cy, "scale": 2000, "depth_deformation": {"range": 0.01}}
    path.write_text(json.dumps({"camera": camera}))
    read = open_recording(box_recording, camera_file=path, report=False)
    assert read.camera == replace(c, fx=c.fx * 1.1)
    scaled = plain[0].depth / 2
    np.testing.assert_allclose(read[0].depth, scaled * (1 + 0.01 * (scaled / 2 - 1)), rtol=1e-5)
    assert open_recording(box_recording, camera_file=path, camera={"fx": 300.0}, report=False).camera.fx == 300.0


def test_a_dataset_of_any_kind_is_read_with_the_file(box_recording: Path, tmp_path: Path) -> None:
    plain, path = open_recording(box_recording, report=False), tmp_path / "camera.json"
    c = plain.camera
    camera = {
        "w": c.width,
        "h": c.height,
        "fx": c.fx * 0.9,
        "fy": c.fy,
        "cx": c.cx,
        "cy": c.cy,
        "scale": 1.02,
        "distortion": [0.1, 0, 0, 0],
    }
    path.write_text(json.dumps({"camera": camera}))
    read = Recalibrated(plain, read_given(path))
    assert read.camera == replace(c, fx=c.fx * 0.9)
    v, u = round(c.cy), round(c.cx)  # where distortion moves nothing
    np.testing.assert_allclose(read[3].depth[v, u], plain[3].depth[v, u] / 1.02, rtol=1e-3)
    assert np.abs(read[3].colour - plain[3].colour).max() > 0.1
    np.testing.assert_array_equal(read.timestamps, plain.timestamps)
    assert len(read) == len(plain)


# Keyframes of a finished run


def test_rows_have_the_times_that_are_stated_or_found() -> None:
    """The read-out of colour is stated, that of depth and the delay are found; depth's stamp is 4 ms later."""
    black = np.zeros((240, 320), np.float32)
    frame = Frame(0, 1.0, np.stack([black] * 3, 2), black, CAMERA, 1.004, SensorTiming(0.02, None, None))
    found = {"depth_readout": SensorTime(0.03, 0.001), "depth_delay": SensorTime(0.001, 0.001)}
    times = row_times(frame, found)
    assert (times.readout, times.depth_readout) == (0.02, 0.03)
    assert times.depth_delay == pytest.approx(0.005)


def test_a_stretch_ends_where_a_frame_is_not_trusted() -> None:
    trusted = np.array([True, False, True, True, True, True, False, True])
    assert stretch_around(trusted, 3, 15) == slice(2, 6)
    assert stretch_around(trusted, 3, 1) == slice(2, 5)
    assert stretch_around(trusted, 0, 2) == slice(0, 1)
    assert stretch_around(trusted, 7, 2) == slice(7, 8)
    assert stretch_around(trusted, 6, 2) == slice(6, 6)


def test_images_of_a_finished_run_are_rectified_by_its_poses() -> None:
    """Turned at 1 rad/s about its vertical axis, the first row of a read-out of 40 ms shows all 20 mrad, 5.8 px, to the right."""
    seconds = np.arange(11) / FPS
    poses = np.tile(np.eye(4), (11, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(seconds[:, None] * [0, 1.0, 0]).as_matrix()
    run = SimpleNamespace(trusted=np.full(11, True), trajectory=Trajectory(seconds, poses))
    x = np.arange(320, dtype=np.float32)
    stripes = np.tile((0.5 + 0.4 * np.sin(x / 8))[None, :, None], (240, 1, 3)).astype(np.float32)
    wall = np.full((240, 320), 2.0, np.float32)
    frame = Frame(5, float(seconds[5]), stripes, wall, CAMERA, None, SensorTiming(0.04, 0.0, 0.0))
    view, motion = rectified_keyframe(run, frame, {})  # type: ignore[arg-type]
    np.testing.assert_allclose(motion.velocity, [0, 0, 0, 0, 1, 0], atol=1e-6)
    assert motion.rectification is not None and motion.rectification.times.readout == 0.04
    shown = 0.5 + 0.4 * np.sin((x[100:200] + 5.8) / 8)
    np.testing.assert_allclose(view.grey[1, 100:200] / 255, shown, atol=0.04)
    unsure = {"readout": SensorTime(0.01, 0.005), "depth_readout": SensorTime(0.002, 0.001)}  # not used for the images
    plain, moving = rectified_keyframe(run, replace(frame, timing=SensorTiming(None, None, 0.0)), unsure)  # type: ignore[arg-type]
    np.testing.assert_allclose(plain.grey[1, 100:200] / 255, stripes[1, 100:200, 0], atol=0.01)
    assert moving.rectification is None and moving.times.readout == 0.01
    still, unmoved = rectified_keyframe(run, replace(frame, timing=SensorTiming()), {})  # type: ignore[arg-type]
    np.testing.assert_allclose(still.grey[1, 100:200] / 255, stripes[1, 100:200, 0], atol=0.01)
    assert unmoved.synchronised


# The command


def test_too_few_views_are_one_line(box_recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["calibrate", str(box_recording), "--frames", "2"])
    assert end.value.code == 1
    assert "too few landmarks in common" in capsys.readouterr().err


def test_a_camera_that_does_not_explain_the_images_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    shaken, source = replace(estimate(focal=0.11), noise=0.64), RecordingSource("somewhere")
    assert not shaken.explains_images and estimate().explains_images
    monkeypatch.setattr("idfslam.runs.calibration.calibrate", lambda *args, **flags: (shaken, None, {}))
    assert with_own_camera(source, FAST, tmp_path / "camera.json", None) is source
    assert not (tmp_path / "camera.json").exists()
    assert "no camera explains the images to better than 0.64 px of 640, expected 0.3" in caplog.text


@pytest.mark.slow
def test_the_command_finds_a_wrong_focal_length(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A generated room that is read with a focal length that is 4 % too long."""
    c = open_recording("synthetic:0:kinect").camera
    stated, out = tmp_path / "stated.json", tmp_path / "found.json"
    stated.write_text(json.dumps({"camera": {"fx": c.fx * 1.04, "fy": c.fy * 1.04, "cx": c.cx, "cy": c.cy}}))
    main(["calibrate", "synthetic:0:kinect", "--frames", "60", "--stride", "4", "--camera-file", str(stated), "--out", str(out)])
    said = capsys.readouterr().out
    assert "the focal length looks 4.0 % too long" in said
    assert "not determined" in said  # the scale of depth
    found = read_given(out)
    assert found.fx == pytest.approx(c.fx, rel=0.003)
    assert found.cx == pytest.approx(c.cx, abs=1.5)
    assert found.over(Calibration()).complete


def test_recordings_of_different_cameras_are_refused(box_recording: Path) -> None:
    cameras = open_recording(box_recording, report=False), open_recording(box_recording, camera={"fx": 200.0}, report=False)
    empty = [Keyframes(recording, np.zeros(0, np.int64), [], np.zeros((0, 4, 4)), []) for recording in cameras]
    with pytest.raises(ConfigError, match="stated differently"):
        calibrate_from(empty, truth=False)


def test_a_guess_gives_way_where_a_stated_value_would_stay(tmp_path: Path) -> None:
    """A focal length that is 1 % off, by an estimate that is that uncertain."""
    found = estimate(sigma=0.01, focal=0.01)

    class Read:
        camera = CAMERA

        def __init__(self, source: str) -> None:
            self.provenance = Provenance(source)

    for source, focal in (("intrinsics.txt", CAMERA.fx), ("a guess: 65 degrees across", 1.01 * CAMERA.fx)):
        write_camera(tmp_path / "camera.json", found, Read(source))  # type: ignore[arg-type]
        assert json.loads((tmp_path / "camera.json").read_text())["camera"]["fx"] == pytest.approx(focal)
