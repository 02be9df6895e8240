"""Depth cameras through OpenCV: two video devices, one of them of depth, or one device that OpenCV knows to give both."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.calibration import Calibration
from idfslam.datasets.images import metres, rgb
from idfslam.errors import CameraError
from idfslam.frame import Frame
from idfslam.live.depth_camera import Capture

Read = Callable[[], tuple[NDArray[np.generic], NDArray[np.generic]] | None]  # colour (H, W, 3) BGR and depth (H, W); None: no more
MILLIMETRES = 1000.0  # units of depth per metre, unless told otherwise


@dataclass(frozen=True)
class Kind:
    """A kind of device that gives colour and depth: OpenCV's numbers for it."""

    backend: int
    colour: int  # the images, for `retrieve`
    depth: int
    intrinsics: tuple[int, int, int, int] | None  # the properties fx, fy, cx, cy [px]
    registration: int | None  # the property that registers depth to colour


KINDS = {
    "openni": Kind(cv2.CAP_OPENNI2, cv2.CAP_OPENNI_BGR_IMAGE, cv2.CAP_OPENNI_DEPTH_MAP, None, cv2.CAP_OPENNI_DEPTH_GENERATOR_REGISTRATION),
    "orbbec": Kind(
        cv2.CAP_OBSENSOR,
        cv2.CAP_OBSENSOR_BGR_IMAGE,
        cv2.CAP_OBSENSOR_DEPTH_MAP,
        (
            cv2.CAP_PROP_OBSENSOR_INTRINSIC_FX,
            cv2.CAP_PROP_OBSENSOR_INTRINSIC_FY,
            cv2.CAP_PROP_OBSENSOR_INTRINSIC_CX,
            cv2.CAP_PROP_OBSENSOR_INTRINSIC_CY,
        ),
        None,  # OpenCV registers by itself
    ),
}


class OpenCvCamera:
    """Devices that OpenCV has opened, and how their images are read. Raises CameraError where they are not colour and depth."""

    def __init__(self, name: str, devices: Sequence[cv2.VideoCapture], read: Read, calibration: Calibration) -> None:
        self.name, self._devices, self._read = name, devices, read
        self._clock = time.time() - time.perf_counter()  # seconds since 1970 that no setting of the clock moves
        images = read()
        if images is None:
            raise CameraError(f"{name}: opened, but gives no images: is another program using it?")
        height, width = self._checked(*images)[1].shape
        self.camera = calibration.camera(width, height, name)
        self._scale = calibration.over(Calibration(depth_scale=MILLIMETRES)).scale(name)

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
        if depth.dtype == np.uint8 and depth.size == 2 * height * width:  # the bytes as they came: OpenCV has no name for depth
            depth = np.ascontiguousarray(depth).view(np.uint16).reshape(height, width)
        if bgr.shape != (height, width, 3) or bgr.dtype != np.uint8 or depth.shape != (height, width) or depth.dtype != np.uint16:
            found = f"colour {bgr.shape} {bgr.dtype}, depth {depth.shape} {depth.dtype}"
            raise CameraError(f"{self.name}: {found}, expected 8-bit colour (H, W, 3) and 16-bit depth (H, W), registered to it")
        return np.asarray(bgr, np.uint8), np.asarray(depth, np.uint16)

    def _retrieve(self, bgr: NDArray[np.uint8], raw: NDArray[np.uint16], stamp: float, index: int) -> Frame:
        return Frame(index, stamp, rgb(bgr), metres(raw, self._scale), self.camera)


def open_pair(colour: str, depth: str, calibration: Calibration) -> OpenCvCamera:
    """A colour device and a depth device whose depth is registered to colour; `calibration` has the camera. Raises CameraError."""
    devices = [_opened(which, cv2.CAP_ANY) for which in (colour, depth)]
    devices[1].set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"Z16 "))
    devices[1].set(cv2.CAP_PROP_CONVERT_RGB, 0)  # depth is no picture

    def read() -> tuple[NDArray[np.generic], NDArray[np.generic]] | None:
        if not all([device.grab() for device in devices]):  # both before either is decoded: as near in time as can be
            return None
        (good, bgr), (also_good, raw) = (device.retrieve() for device in devices)
        return (bgr, raw) if good and also_good else None

    return OpenCvCamera("opencv", devices, read, calibration)


def open_device(kind: str, number: str, calibration: Calibration) -> OpenCvCamera:
    """One device of a kind that gives both images. Raises CameraError."""
    numbers = KINDS[kind]
    if not cv2.videoio_registry.hasBackend(numbers.backend):
        raise CameraError(f"{kind}: OpenCV {cv2.__version__} was built without it here, expected a build that has it (see docs/live.md)")
    device = _opened(number, numbers.backend)
    if numbers.registration is not None:
        device.set(numbers.registration, 1)
    if numbers.intrinsics is not None:
        fx, fy, cx, cy = (device.get(number) for number in numbers.intrinsics)
        calibration = calibration.over(Calibration(fx, fy, cx, cy, source=f"the {kind} device") if fx > 0 else Calibration())

    def read() -> tuple[NDArray[np.generic], NDArray[np.generic]] | None:
        if not device.grab():
            return None
        (good, bgr), (also_good, raw) = (device.retrieve(flag=flag) for flag in (numbers.colour, numbers.depth))
        return (bgr, raw) if good and also_good else None

    return OpenCvCamera(f"{kind}-{number}", [device], read, calibration)


def _opened(which: str, backend: int) -> cv2.VideoCapture:
    """A device by its number, or anything else that OpenCV opens: a stream's address, numbered images."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the message below says it all
    device = cv2.VideoCapture(int(which) if which.isdecimal() else which, backend)
    cv2.utils.logging.setLogLevel(level)
    if not device.isOpened():
        raise CameraError(f"video device {which}: not there or in use, expected a camera (Linux: ls /dev/video*)")
    return device
