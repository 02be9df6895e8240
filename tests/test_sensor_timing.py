"""Times of a sensor, and the two time stamps of a frame."""

import numpy as np
import pytest

from idfslam.errors import ConfigError, FrameError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.geometry.sensor_timing import SYNCHRONISED, SensorTiming

CAMERA = Camera(4, 3, 4.0, 4.0, 1.5, 1.0)
IMAGES = np.zeros((3, 4, 3), np.float32), np.ones((3, 4), np.float32)


def test_a_frame_without_a_stamp_of_depth_is_synchronised() -> None:
    frame = Frame(0, 1.5, *IMAGES, CAMERA)
    assert frame.depth_timestamp == 1.5
    assert frame.depth_lag == 0.0
    assert frame.timing == SYNCHRONISED == SensorTiming(0.0, 0.0, 0.0)


def test_colour_and_depth_keep_their_stamps() -> None:
    frame = Frame.from_images(*IMAGES, CAMERA, timestamp=1.5, depth_timestamp=1.52, timing=SensorTiming(0.026, None, 0.004))
    assert frame.depth_lag == pytest.approx(0.02)
    assert frame.timing.depth_readout is None


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"readout": 26}, r"readout is 26, expected seconds from 0 to 0.5"),
        ({"depth_readout": -0.01}, r"depth_readout is -0.01, expected seconds from 0 to 0.5"),
        ({"depth_delay": float("nan")}, r"depth_delay is nan, expected seconds from -0.5 to 0.5"),
    ],
)
def test_times_that_are_no_sensors_are_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        SensorTiming(**values)


def test_wrong_times_of_a_frame_are_refused() -> None:
    with pytest.raises(FrameError, match="timestamp is nan"):
        Frame(0, 0.0, *IMAGES, CAMERA, depth_timestamp=float("nan"))
    with pytest.raises(FrameError, match="timing is float, expected a SensorTiming"):
        Frame(0, 0.0, *IMAGES, CAMERA, timing=0.026)  # type: ignore[arg-type]


def test_stamps_of_different_clocks_are_no_lag() -> None:
    assert Frame(0, 1.5, *IMAGES, CAMERA, depth_timestamp=7.0).depth_lag == 0.0
    assert Frame(0, 1.5, *IMAGES, CAMERA, depth_timestamp=1.42).depth_lag == pytest.approx(-0.08)
