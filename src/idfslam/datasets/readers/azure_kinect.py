"""Azure Kinect, and Orbbec's Femto with the same recorder: a .mkv file of a colour track, a 16-bit depth track [mm] and calibration.json.

The calibration registers depth to colour. Colour is downscaled to 640 pixels a side, about the resolution of the depth camera. The
calibration describes the whole sensors, in fractions of their size; the size of the images tells which part of a sensor they show (k4a,
Azure Kinect Sensor SDK: mode-specific calibration). The pixels of its depth camera have a global shutter (Bamji et al., ISSCC 2018).
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration, DepthCameraCalibration
from idfslam.datasets.images.decoding import Depth
from idfslam.datasets.images.partners import stamps_of, warn_without_own, with_nearest
from idfslam.datasets.images.resampling import limited_size
from idfslam.datasets.images.video import VideoContents, VideoTrack, read_contents
from idfslam.datasets.recording import Reader, Recording
from idfslam.errors import RecordingError
from idfslam.geometry.association import TOLERANCE, associate
from idfslam.storage.json_file import parse_json
from idfslam.storage.plain_values import fault

_COLOUR, _DEPTH = "CALIBRATION_CameraLocationPV0", "CALIBRATION_CameraLocationD0"
_DEPTH_MODES = {  # size of the images: size of the whole sensor after binning, first column and row of the images in it
    (640, 576): (1024, 1024, 192, 180),
    (320, 288): (512, 512, 96, 90),
    (1024, 1024): (1024, 1024, 0, 0),
    (512, 512): (512, 512, 0, 0),
}


def recognises(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() == ".mkv"


def open_azure_kinect(path: Path, stated: Calibration) -> Recording:
    """Pairs colour and depth images whose stamps differ by at most 20 ms, once the depth delay in the recording's tags is subtracted.

    Every colour image is a frame, also one without a depth image.
    """
    contents = read_contents(path)
    colour, depth = _tracks(path, contents)
    times = depth.times - _delay(path, contents)  # as if depth had been taken with colour
    pairs = associate(colour.times, times)
    if not len(pairs):
        raise RecordingError(f"{path}: no colour and depth image within {1000 * TOLERANCE:.0f} ms, expected both tracks of one recording")
    partner = with_nearest(pairs, colour.times, times)
    warn_without_own(str(path), len(pairs), len(partner))
    size = limited_size(*colour.size)
    file = contents.tags.get("K4A_CALIBRATION_FILE", "calibration.json")
    calibration, depth_camera = Calibration(), None
    if file in contents.attachments:
        calibration, depth_camera = read_calibration(contents.attachments[file], colour.size, depth.size, f"{path}: {file}")
    if depth_camera is None and colour.size != depth.size:
        found = f"colour {colour.size[0]}x{colour.size[1]}, depth {depth.size[0]}x{depth.size[1]} and no {file} attached"
        raise RecordingError(f"{path}: {found}, expected the calibration as k4arecorder writes it: record again")

    def read(i: int) -> tuple[NDArray[np.uint8], Depth | None]:
        return colour.colour(i, size if depth_camera else None), depth.grey16(int(partner[i])) if partner[i] >= 0 else None

    calibration = stated.over(calibration).over(Calibration(depth_readout=0))
    return Recording(
        path.stem,
        read,
        timestamps=colour.times,
        depth_timestamps=stamps_of(depth.times, partner),
        ground_truth=None,
        calibration=(calibration.resized(colour.size, size) if depth_camera else calibration).over(Calibration(depth_scale=1000)),
        depth_camera=depth_camera,
        random_access=False,
    )


def _delay(path: Path, contents: VideoContents) -> float:
    """The delay [s] of depth images after their colour images."""
    delay = contents.tags.get("K4A_DEPTH_DELAY_NS") or "0"
    try:
        return float(delay) / 1e9
    except ValueError as error:
        raise RecordingError(f"{path}: K4A_DEPTH_DELAY_NS is {delay}, expected nanoseconds: correct or remove the tag") from error


def _tracks(path: Path, contents: VideoContents) -> tuple[VideoTrack, VideoTrack]:
    """The colour and depth tracks by their titles, else by their pixel formats (the infrared track comes after depth)."""
    grey = [form.startswith("gray16") for form in contents.formats]
    numbers = [
        contents.titles.index(title) if title in contents.titles else grey.index(is_grey) if is_grey in grey else None
        for title, is_grey in (("COLOR", False), ("DEPTH", True))
    ]
    if numbers[0] is None or numbers[1] is None:
        raise RecordingError(f"{path}: video tracks {', '.join(contents.formats) or 'none'}, expected colour and 16-bit grey depth")
    return VideoTrack(path, numbers[0]), VideoTrack(path, numbers[1])


def read_calibration(
    data: bytes, colour_size: tuple[int, int], depth_size: tuple[int, int], source: str
) -> tuple[Calibration, DepthCameraCalibration]:
    """The calibrations of the colour camera, for images of `colour_size`, and of the depth camera; raises RecordingError."""
    try:
        cameras = {camera["Location"]: camera for camera in _json(data, source)["CalibrationInformation"]["Cameras"]}
        colour, depth = cameras[_COLOUR], cameras[_DEPTH]
        T_colour_depth = _T(colour) @ np.linalg.inv(_T(depth))
        width, height = colour_size
        whole = (width, width * 3 // 4)  # the sensor is 4:3; images of other proportions show its middle rows
        depth_camera = DepthCameraCalibration(_camera(depth, depth_size, *_DEPTH_MODES[depth_size], source), T_colour_depth)
        return _camera(colour, colour_size, *whole, 0, (whole[1] - height) // 2, source), depth_camera
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, np.linalg.LinAlgError) as error:
        sizes = f"depth images of {depth_size[0]}x{depth_size[1]}"
        raise RecordingError(f"{source}: {fault(error)}, expected the calibration of an Azure Kinect for {sizes}") from error


def _json(data: bytes, source: str) -> Any:
    return parse_json(data, source=source, error=RecordingError, expected="the calibration of an Azure Kinect")


def _camera(camera: dict[str, Any], size: tuple[int, int], width: int, height: int, left: int, top: int, source: str) -> Calibration:
    """width, height: of the whole sensor [px]. left, top: the first column and row of the sensor that the images show."""
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = (float(value) for value in camera["Intrinsics"]["ModelParameters"])
    distortion = (k1, k2, p1, p2, k3, k4, k5, k6)
    return Calibration(fx * width, fy * height, cx * width - left - 0.5, cy * height - top - 0.5, *size, distortion, source=source)


def _T(camera: dict[str, Any]) -> NDArray[np.float64]:
    """(4, 4) from the depth camera's frame to this camera's [m]."""
    T = np.eye(4)
    T[:3, :3] = np.array(camera["Rt"]["Rotation"], np.float64).reshape(3, 3)
    T[:3, 3] = camera["Rt"]["Translation"]
    return T


READER = Reader("azure_kinect", "a .mkv file of an Azure Kinect or Femto", recognises, open_azure_kinect)
