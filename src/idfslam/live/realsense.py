"""Intel RealSense cameras and their recordings (.db3, .bag), through pyrealsense2: depth aligned to colour, intrinsics from the device."""

from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.images.decoding import Undistortion, metres, rgb
from idfslam.errors import CameraError, ConfigError, pip_install
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.geometry.sensor_timing import LONGEST, SensorTiming
from idfslam.live.depth_camera import Capture

WIDTH, HEIGHT, RATE = 640, 480, 30  # [px], [Hz] every model has this mode for colour and depth
# Read-out times [s] that are published: these models have pixels with a global shutter (Intel RealSense D400 series, product table)
GLOBAL_SHUTTERS = {"D435": SensorTiming(None, 0.0, None), "D455": SensorTiming(0.0, 0.0, None)}
TIMEOUT = 4000  # [ms] of waiting for images; raised, a disconnected camera is noticed later. Chosen by hand


class RealSense:
    """A camera by its serial number, any connected one, or a recorded file. Raises CameraError if there is none.

    times: what the user states about the sensor's times; else what is published about the model counts.
    """

    def __init__(self, which: str = "", times: Calibration | None = None) -> None:
        self._rs = rs = _pyrealsense2()
        self._file = Path(which).suffix in (".db3", ".bag")
        self.name = Path(which).stem if self._file else f"realsense-{which}" if which else "realsense"
        self._check_presence(which)
        self._pipeline, config = rs.pipeline(), rs.config()
        if self._file:
            config.enable_device_from_file(which, repeat_playback=False)
        else:
            if which:
                config.enable_device(which)
            config.enable_stream(rs.stream.depth, WIDTH, HEIGHT, rs.format.z16, RATE)
            config.enable_stream(rs.stream.color, WIDTH, HEIGHT, rs.format.bgr8, RATE)
        try:
            profile = self._pipeline.start(config)
            self._device = profile.get_device()
            self._scale = 1 / self._device.first_depth_sensor().get_depth_scale()  # units per metre
            intrinsics = profile.get_stream(rs.stream.color).as_video_stream_profile().get_intrinsics()
        except RuntimeError as error:
            wanted = f"colour and depth of {WIDTH}x{HEIGHT} at {RATE} Hz, on USB 3"
            raise CameraError(f"{self.name}: {error}{'' if self._file else f'; expected {wanted}'}") from error
        self.camera = Camera(intrinsics.width, intrinsics.height, intrinsics.fx, intrinsics.fy, intrinsics.ppx, intrinsics.ppy)
        self.timing = (times or Calibration()).over(_published(self._device, rs)).timing()
        self._undistort = self._undistortion(intrinsics)
        self._align = rs.align(rs.stream.color)

    def grab(self) -> Capture | None:
        try:
            images = self._pipeline.wait_for_frames(TIMEOUT)
        except RuntimeError as error:
            if self._file:
                return None
            raise CameraError(f"{self.name}: {error}: is it still plugged in?") from error
        images.keep()
        return Capture(images.get_color_frame().get_timestamp() / 1000, partial(self._retrieve, images))

    def close(self) -> None:
        self._pipeline.stop()

    def _retrieve(self, images: Any, index: int) -> Frame:
        aligned = self._align.process(images)
        colour = aligned.get_color_frame()
        bgr: NDArray[np.uint8] = np.asanyarray(colour.get_data())
        raw: NDArray[np.uint16] = np.asanyarray(aligned.get_depth_frame().get_data())
        if colour.get_profile().format() == self._rs.format.rgb8:  # in recorded files
            bgr = bgr[..., ::-1]
        if self._undistort is not None:
            bgr, raw = self._undistort.colour(bgr), np.asarray(self._undistort.depth(raw), np.uint16)
        stamp, depth_stamp = colour.get_timestamp() / 1000, images.get_depth_frame().get_timestamp() / 1000
        one_clock = abs(depth_stamp - stamp) < LONGEST
        views = rgb(np.ascontiguousarray(bgr)), metres(raw, self._scale)
        return Frame(index, stamp, *views, self.camera, depth_stamp if one_clock else None, self.timing)

    def _undistortion(self, intrinsics: Any) -> Undistortion | None:
        """Undistortion if the camera has distortion.

        The D400 series calls its model inverse Brown-Conrady. Like the ROS driver, this uses it as OpenCV's: its coefficients are so small
        that the two agree.
        """
        if not any(intrinsics.coeffs):
            return None
        kinds = self._rs.distortion
        if intrinsics.model not in (kinds.brown_conrady, kinds.modified_brown_conrady, kinds.inverse_brown_conrady):
            raise CameraError(f"{self.name}: distortion of the kind {intrinsics.model}, expected Brown-Conrady's")
        return Undistortion(self.camera, tuple(intrinsics.coeffs))

    def _check_presence(self, which: str) -> None:
        """Raises CameraError if the camera or file is missing; librealsense would wait for it."""
        if self._file:
            if not Path(which).is_file():
                raise CameraError(f"{which}: no such file, expected a recording of a RealSense camera")
            return
        serial_numbers = [device.get_info(self._rs.camera_info.serial_number) for device in self._rs.context().query_devices()]
        if not serial_numbers or (which and which not in serial_numbers):
            wanted = f"the one with serial number {which}" if which else "one that is plugged in"
            raise CameraError(f"RealSense: found {', '.join(serial_numbers) or 'no camera'}, expected {wanted}")


def _published(device: Any, rs: ModuleType) -> Calibration:
    """The times that are published about a device's model."""
    name = str(device.get_info(rs.camera_info.name)) if device.supports(rs.camera_info.name) else ""
    times = next((times for model, times in GLOBAL_SHUTTERS.items() if model in name), None)
    return Calibration() if times is None else Calibration().with_times(times)


def _pyrealsense2() -> ModuleType:
    try:
        import pyrealsense2
    except ImportError as error:
        raise ConfigError(f"RealSense cameras need pyrealsense2: {pip_install('pyrealsense2')}") from error
    return pyrealsense2  # type: ignore[no-any-return]
