"""Depth cameras through OpenCV: a colour and a depth video device, or one device from which OpenCV reads both."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.images.decoding import metres, rgb
from idfslam.errors import CameraError
from idfslam.frame import Frame
from idfslam.live.depth_camera import Capture

Read = Callable[[], tuple[NDArray[np.generic], NDArray[np.generic]] | None]  # colour (H, W, 3) BGR and depth (H, W); None: no images
MILLIMETRES = 1000.0  # default units of depth per metre


@dataclass(frozen=True)
class DeviceKind:
    """OpenCV's constants for a kind of device that gives colour and depth."""

    backend: int
    colour: int  # image numbers for `VideoCapture.retrieve`
    depth: int
    intrinsics: tuple[int, int, int, int] | None  # the properties fx, fy, cx, cy [px]
    registration: int | None  # the property that registers depth to colour


DEVICE_KINDS = {
    "openni": DeviceKind(
        cv2.CAP_OPENNI2, cv2.CAP_OPENNI_BGR_IMAGE, cv2.CAP_OPENNI_DEPTH_MAP, None, cv2.CAP_OPENNI_DEPTH_GENERATOR_REGISTRATION
    ),
    "orbbec": DeviceKind(
        cv2.CAP_OBSENSOR,
        cv2.CAP_OBSENSOR_BGR_IMAGE,
        cv2.CAP_OBSENSOR_DEPTH_MAP,
        (
            cv2.CAP_PROP_OBSENSOR_INTRINSIC_FX,
            cv2.CAP_PROP_OBSENSOR_INTRINSIC_FY,
            cv2.CAP_PROP_OBSENSOR_INTRINSIC_CX,
            cv2.CAP_PROP_OBSENSOR_INTRINSIC_CY,
        ),
        None,  # OpenCV always registers depth
    ),
}


class OpenCvCamera:
    """A camera of opened OpenCV devices. Raises CameraError if they do not give colour and depth."""

    def __init__(self, name: str, devices: Sequence[cv2.VideoCapture], read: Read, calibration: Calibration) -> None:
        self.name, self._devices, self._read = name, devices, read
        self._clock = time.time() - time.perf_counter()  # [s] since 1970; not moved when the system clock is set
        images = read()
        if images is None:
            raise CameraError(f"{name}: opened, but gives no images: is another program using it?")
        height, width = self._checked(*images)[1].shape
        self.camera = calibration.camera(width, height, name)
        self._scale = calibration.over(Calibration(depth_scale=MILLIMETRES)).scale(name)
        self.timing = calibration.timing()

    def grab(self) -> Capture | None:
        images = self._read()
        if images is None:
            raise CameraError(f"{self.name}: no more images: is it still plugged in?")
        stamp = self._clock + time.perf_counter()
        return Capture(stamp, partial(self._retrieve, *self._checked(*images), stamp))

    def close(self) -> None:
        for device in self._devices:
            device.release()

    def _checked(self, bgr: NDArray[np.generic], depth: NDArray[np.generic]) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        """Colour (H, W, 3) uint8 and depth (H, W) uint16 of one size. Raises CameraError for anything else."""
        height, width = bgr.shape[:2]
        if depth.dtype == np.uint8 and depth.size == 2 * height * width:  # raw bytes: OpenCV has no type for depth
            depth = np.ascontiguousarray(depth).view(np.uint16).reshape(height, width)
        if bgr.shape != (height, width, 3) or bgr.dtype != np.uint8 or depth.shape != (height, width) or depth.dtype != np.uint16:
            found = f"colour {bgr.shape} {bgr.dtype}, depth {depth.shape} {depth.dtype}"
            raise CameraError(f"{self.name}: {found}, expected 8-bit colour (H, W, 3) and 16-bit depth (H, W), registered to it")
        return np.asarray(bgr, np.uint8), np.asarray(depth, np.uint16)

    def _retrieve(self, bgr: NDArray[np.uint8], raw: NDArray[np.uint16], stamp: float, index: int) -> Frame:
        return Frame(index, stamp, rgb(bgr), metres(raw, self._scale), self.camera, timing=self.timing)


def open_pair(colour: str, depth: str, calibration: Calibration) -> OpenCvCamera:
    """Opens a colour device and a depth device that is registered to it; `calibration` is the camera's. Raises CameraError."""
    devices = [_open_device(which, cv2.CAP_ANY) for which in (colour, depth)]
    devices[1].set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"Z16 "))
    devices[1].set(cv2.CAP_PROP_CONVERT_RGB, 0)  # depth must not be converted to RGB

    def read() -> tuple[NDArray[np.generic], NDArray[np.generic]] | None:
        if not all([device.grab() for device in devices]):  # both before either is decoded, for the smallest delay between them
            return None
        (good, bgr), (also_good, raw) = (device.retrieve() for device in devices)
        return (bgr, raw) if good and also_good else None

    return OpenCvCamera("opencv", devices, read, calibration)


def open_device(kind: str, number: str, calibration: Calibration) -> OpenCvCamera:
    """Opens one device that gives both images. Raises CameraError."""
    device_kind = DEVICE_KINDS[kind]
    if not cv2.videoio_registry.hasBackend(device_kind.backend):
        raise CameraError(f"{kind}: OpenCV {cv2.__version__} was built without it here, expected a build that has it (see docs/live.md)")
    device = _open_device(number, device_kind.backend)
    if device_kind.registration is not None:
        device.set(device_kind.registration, 1)
    if device_kind.intrinsics is not None:
        fx, fy, cx, cy = (device.get(number) for number in device_kind.intrinsics)
        calibration = calibration.over(Calibration(fx, fy, cx, cy, source=f"the {kind} device") if fx > 0 else Calibration())

    def read() -> tuple[NDArray[np.generic], NDArray[np.generic]] | None:
        if not device.grab():
            return None
        (good, bgr), (also_good, raw) = (device.retrieve(flag=flag) for flag in (device_kind.colour, device_kind.depth))
        return (bgr, raw) if good and also_good else None

    return OpenCvCamera(f"{kind}-{number}", [device], read, calibration)


def _open_device(which: str, backend: int) -> cv2.VideoCapture:
    """Opens a device by its number, or anything else that OpenCV reads: the address of a stream, numbered images."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the error below replaces its messages
    device = cv2.VideoCapture(int(which) if which.isdecimal() else which, backend)
    cv2.utils.logging.setLogLevel(level)
    if not device.isOpened():
        raise CameraError(f"video device {which}: not there or in use, expected a camera (Linux: ls /dev/video*)")
    return device
