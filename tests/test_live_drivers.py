"""The drivers: RealSense with the real library and a recording that it makes itself, OpenCV with images on disk and with fakes."""

import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from helpers.recordings import colour_image
from idfslam.errors import CameraError, ConfigError, RecordingError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.live import LiveStream, open_live, realsense
from idfslam.live import opencv as driver

WIDTH, HEIGHT = 64, 48
GIVEN = {"fx": 15.0, "fy": 15.0, "cx": 7.5, "cy": 5.5}


def frames_of(stream: LiveStream) -> list[Frame]:
    found = [frame for _, frame in stream]
    assert all(isinstance(frame, Frame) for frame in found)
    return found  # type: ignore[return-value]


def record_realsense(path: Path, *, coefficients: list[float], frames: int = 12) -> None:
    """A wall 1 m away, grey growing by one a frame, from a device that librealsense simulates."""
    rs: Any = pytest.importorskip("pyrealsense2")
    device = rs.software_device()
    sensors = [device.add_sensor(name) for name in ("Depth", "Colour")]
    profiles = []
    for sensor, kind, fmt, size in ((sensors[0], rs.stream.depth, rs.format.z16, 2), (sensors[1], rs.stream.color, rs.format.bgr8, 3)):
        intrinsics, stream = rs.intrinsics(), rs.video_stream()
        intrinsics.width, intrinsics.height, intrinsics.fx, intrinsics.fy = WIDTH, HEIGHT, 60.0, 61.0
        intrinsics.ppx, intrinsics.ppy, intrinsics.coeffs = 31.5, 23.5, coefficients if size == 3 else [0.0] * 5
        intrinsics.model = rs.distortion.inverse_brown_conrady if size == 3 else rs.distortion.none
        stream.type, stream.fmt, stream.intrinsics, stream.uid, stream.bpp = kind, fmt, intrinsics, size, size
        stream.width, stream.height, stream.fps = WIDTH, HEIGHT, 30
        profiles.append(sensor.add_video_stream(stream).as_video_stream_profile())
    sensors[0].add_read_only_option(rs.option.depth_units, 0.0005)
    same = rs.extrinsics()
    same.rotation, same.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [0, 0, 0]
    profiles[0].register_extrinsics_to(profiles[1], same)
    recorder = rs.recorder(str(path), device)
    opened = recorder.query_sensors()
    for sensor, profile in zip(opened, profiles):
        sensor.open(profile)
        sensor.start(lambda frame: None)
    kept = []
    for i in range(frames):
        images = (np.full((HEIGHT, WIDTH), 2000, np.uint16), np.full((HEIGHT, WIDTH, 3), (10 + i, 20, 200), np.uint8))
        for sensor, profile, image in zip(sensors, profiles, images):
            one = rs.software_video_frame()
            one.pixels, one.bpp, one.stride = image, image.nbytes // (HEIGHT * WIDTH), image.nbytes // HEIGHT
            one.timestamp, one.domain, one.frame_number, one.profile = 1e6 + 33.0 * i, rs.timestamp_domain.hardware_clock, i, profile
            sensor.on_video_frame(one)
            kept.append((one, image))
        time.sleep(0.033)  # the player keeps the recorder's pace
    for sensor in opened:
        sensor.stop()
        sensor.close()


@pytest.mark.parametrize("coefficients", [[0.0] * 5, [0.1, 0.0, 0.0, 0.0, 0.0]])
def test_realsense(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, coefficients: list[float]) -> None:
    monkeypatch.setattr(realsense, "TIMEOUT", 1500)  # a file's end is known by it
    record_realsense(tmp_path / "a.db3", coefficients=coefficients)
    stream = open_live(f"realsense:{tmp_path / 'a.db3'}")
    assert stream.camera == Camera(WIDTH, HEIGHT, 60.0, 61.0, 31.5, 23.5)
    frames = frames_of(stream)
    assert 2 <= len(frames) <= 12
    assert stream.failure is None
    stamps = [frame.timestamp for frame in frames]
    assert np.all(np.diff(stamps) > 0)
    assert 1000 <= stamps[0] <= stamps[-1] <= 1000.4
    for frame in frames:
        number = round((frame.timestamp - 1000) / 0.033)
        centre = frame.colour[HEIGHT // 2, WIDTH // 2]
        assert centre == pytest.approx(np.array([200, 20, 10 + number]) / 255)  # RGB, and of its own moment
        assert frame.depth[HEIGHT // 2, WIDTH // 2] == pytest.approx(1.0)  # 2000 units of 0.5 mm
        assert frame.colour[0, 0].any() != any(coefficients)  # undistorted, a corner shows what no pixel saw


def test_realsense_that_is_not_there() -> None:
    pytest.importorskip("pyrealsense2")
    with pytest.raises(CameraError, match=r"RealSense: found .*, expected the one with serial number 987654"):
        open_live("realsense:987654")
    with pytest.raises(CameraError, match="no such file"):
        open_live("realsense:nowhere.db3")


def test_without_pyrealsense_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(ConfigError, match="-m pip install pyrealsense2"):
        open_live("realsense")


def write_numbered(folder: Path, *, frames: int) -> tuple[str, str]:
    """Patterns of colour and 16-bit depth images, for `images_as_devices`."""
    for i in range(frames):
        cv2.imwrite(str(folder / f"rgb{i:03d}.png"), colour_image(i))
        cv2.imwrite(str(folder / f"depth{i:03d}.png"), np.full((12, 16), 1500 + i, np.uint16))
    return str(folder / "rgb%03d.png"), str(folder / "depth%03d.png")


@pytest.fixture
def images_as_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenCV's own reader of numbered images stands for the video devices."""
    opened = cv2.VideoCapture
    monkeypatch.setattr(driver.cv2, "VideoCapture", lambda which, backend: opened(which, cv2.CAP_IMAGES))


@pytest.mark.usefixtures("images_as_devices")
def test_a_pair_of_devices(tmp_path: Path) -> None:
    colour, depth = write_numbered(tmp_path, frames=6)
    stream = open_live(f"opencv:{colour}:{depth}", camera=GIVEN, frames=1)
    assert stream.camera == Camera(16, 12, 15.0, 15.0, 7.5, 5.5)
    (frame,) = frames_of(stream)
    i = round(frame.depth[0, 0] * 1000) - 1500
    assert frame.colour[0, 0] == pytest.approx(np.array([10 + i, 51, 102]) / 255)  # both of one moment
    assert abs(frame.timestamp - time.time()) < 60


@pytest.mark.usefixtures("images_as_devices")
def test_a_pair_that_ends_is_a_camera_that_is_gone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    colour, depth = write_numbered(tmp_path, frames=4)
    stream = open_live(f"opencv:{colour}:{depth}", camera=GIVEN, depth_scale=500)
    frames = frames_of(stream)
    assert frames[-1].depth[0, 0] == pytest.approx(1503 / 500)  # the last one is not lost
    assert "no more images: is it still plugged in?" in str(stream.failure)
    assert "counts as disconnected" in caplog.text


@pytest.mark.usefixtures("images_as_devices")
def test_a_pair_that_is_no_colour_and_depth(tmp_path: Path) -> None:
    colour, depth = write_numbered(tmp_path, frames=2)
    with pytest.raises(CameraError, match="expected 8-bit colour"):
        open_live(f"opencv:{depth}:{colour}", camera=GIVEN)
    with pytest.raises(RecordingError, match="the camera is unknown"):
        open_live(f"opencv:{colour}:{depth}")


class FakeCapture:
    """What cv2.VideoCapture is for a device that gives both images."""

    def __init__(self, which: int, backend: int) -> None:
        self.opened, self.settings, self.released = (which, backend), {}, False
        self.images: dict[int, NDArray[Any]] = {}

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float) -> bool:
        self.settings[key] = value
        return True

    def get(self, key: int) -> float:
        return {
            cv2.CAP_PROP_OBSENSOR_INTRINSIC_FX: 15.0,
            cv2.CAP_PROP_OBSENSOR_INTRINSIC_FY: 16.0,
            cv2.CAP_PROP_OBSENSOR_INTRINSIC_CX: 7.0,
            cv2.CAP_PROP_OBSENSOR_INTRINSIC_CY: 5.0,
        }[key]

    def grab(self) -> bool:
        return True

    def retrieve(self, flag: int) -> tuple[bool, NDArray[Any]]:
        depth = np.full((12, 16), 1500, "<u2").view(np.uint8).reshape(12, 16, 2)  # as the driver of V4L gives it
        images = {cv2.CAP_OBSENSOR_BGR_IMAGE: colour_image(3), cv2.CAP_OBSENSOR_DEPTH_MAP: depth}
        images |= {cv2.CAP_OPENNI_BGR_IMAGE: colour_image(3), cv2.CAP_OPENNI_DEPTH_MAP: np.full((12, 16), 1500, np.uint16)}
        return True, images[flag]

    def release(self) -> None:
        self.released = True


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> list[FakeCapture]:
    made: list[FakeCapture] = []

    def make(which: int, backend: int) -> FakeCapture:
        made.append(FakeCapture(which, backend))
        return made[-1]

    monkeypatch.setattr(driver.cv2, "VideoCapture", make)
    monkeypatch.setattr(driver.cv2, "videoio_registry", SimpleNamespace(hasBackend=lambda number: True))
    return made


def test_an_orbbec_device(fakes: list[FakeCapture]) -> None:
    stream = open_live("orbbec:1", frames=1)
    assert stream.camera == Camera(16, 12, 15.0, 16.0, 7.0, 5.0)  # the device's own
    (frame,) = frames_of(stream)
    assert frame.depth[5, 5] == pytest.approx(1.5)
    assert frame.colour[0, 0] == pytest.approx(np.array([13, 51, 102]) / 255)
    assert fakes[0].opened == (1, cv2.CAP_OBSENSOR)
    assert fakes[0].released


def test_an_openni_device(fakes: list[FakeCapture]) -> None:
    (frame,) = frames_of(open_live("openni", camera=GIVEN, frames=1))
    assert frame.depth[5, 5] == pytest.approx(1.5)
    assert fakes[0].opened == (0, cv2.CAP_OPENNI2)
    assert fakes[0].settings == {cv2.CAP_OPENNI_DEPTH_GENERATOR_REGISTRATION: 1}  # depth registered to colour


@pytest.mark.skipif(cv2.videoio_registry.hasBackend(cv2.CAP_OPENNI2), reason="this OpenCV has OpenNI")
def test_a_kind_that_opencv_was_built_without() -> None:
    with pytest.raises(CameraError, match=r"openni: OpenCV .* was built without it"):
        open_live("openni")
