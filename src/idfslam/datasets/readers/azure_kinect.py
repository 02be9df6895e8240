"""Azure Kinect, and Orbbec's Femto by the same recorder: a .mkv file of a colour track, a 16-bit depth track [mm] and calibration.json.

Depth is registered to colour by the calibration; colour is reduced to 640 pixels a side, about what the depth camera has.
The calibration is for the whole sensors, in fractions of their size; which part of them the images show goes by the images' sizes
(k4a, Azure Kinect Sensor SDK: mode-specific calibration).
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.calibration import Calibration, DepthCamera
from idfslam.datasets.images import Depth
from idfslam.datasets.recording import Reader, Recording
from idfslam.datasets.resampling import moderate
from idfslam.datasets.video import Contents, VideoTrack, read_contents
from idfslam.errors import RecordingError
from idfslam.geometry.association import TOLERANCE, associate

_COLOUR, _DEPTH = "CALIBRATION_CameraLocationPV0", "CALIBRATION_CameraLocationD0"
_DEPTH_MODES = {  # size of the images: size of the whole sensor as binned, the first column and row that the images show
    (640, 576): (1024, 1024, 192, 180),
    (320, 288): (512, 512, 96, 90),
    (1024, 1024): (1024, 1024, 0, 0),
    (512, 512): (512, 512, 0, 0),
}


def recognises(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() == ".mkv"


def open_azure_kinect(path: Path, override: Calibration) -> Recording:
    """Colour and depth images within 20 ms of one another, but for the delay that the recording states, are pairs."""
    contents = read_contents(path)
    colour, depth = _tracks(path, contents)
    pairs = associate(colour.times, depth.times - _delay(path, contents))
    if not len(pairs):
        raise RecordingError(f"{path}: no colour and depth image within {1000 * TOLERANCE:.0f} ms, expected both tracks of one recording")
    size = moderate(*colour.size)
    file = contents.tags.get("K4A_CALIBRATION_FILE", "calibration.json")
    stated, beside = Calibration(), None
    if file in contents.attachments:
        stated, beside = read_calibration(contents.attachments[file], colour.size, depth.size, f"{path}: {file}")
    if beside is None and colour.size != depth.size:
        found = f"colour {colour.size[0]}x{colour.size[1]}, depth {depth.size[0]}x{depth.size[1]} and no {file} attached"
        raise RecordingError(f"{path}: {found}, expected the calibration as k4arecorder writes it: record again")

    def read(i: int) -> tuple[NDArray[np.uint8], Depth]:
        k, m = pairs[i].tolist()
        return colour.colour(k, size if beside else None), depth.grey16(m)

    stated = override.over(stated)
    return Recording(
        path.stem,
        read,
        timestamps=colour.times[pairs[:, 0]],
        ground_truth=None,
        calibration=(stated.resized(colour.size, size) if beside else stated).over(Calibration(depth_scale=1000)),
        depth_camera=beside,
    )


def _delay(path: Path, contents: Contents) -> float:
    """[s] of the depth images behind their colour images."""
    stated = contents.tags.get("K4A_DEPTH_DELAY_NS") or "0"
    try:
        return float(stated) / 1e9
    except ValueError as error:
        raise RecordingError(f"{path}: K4A_DEPTH_DELAY_NS is {stated}, expected nanoseconds: correct or remove the tag") from error


def _tracks(path: Path, contents: Contents) -> tuple[VideoTrack, VideoTrack]:
    """Colour and depth by their titles, else by what they hold (the infrared track comes after depth)."""
    grey = [form.startswith("gray16") for form in contents.formats]
    found = [
        contents.titles.index(title) if title in contents.titles else grey.index(is_grey) if is_grey in grey else None
        for title, is_grey in (("COLOR", False), ("DEPTH", True))
    ]
    if found[0] is None or found[1] is None:
        raise RecordingError(f"{path}: video tracks {', '.join(contents.formats) or 'none'}, expected colour and 16-bit grey depth")
    return VideoTrack(path, found[0]), VideoTrack(path, found[1])


def read_calibration(
    data: bytes, colour_size: tuple[int, int], depth_size: tuple[int, int], source: str
) -> tuple[Calibration, DepthCamera]:
    """The colour camera for images of its size, and the depth camera beside it; raises RecordingError."""
    try:
        cameras = {camera["Location"]: camera for camera in json.loads(data)["CalibrationInformation"]["Cameras"]}
        colour, depth = cameras[_COLOUR], cameras[_DEPTH]
        T_colour_depth = _T(colour) @ np.linalg.inv(_T(depth))
        width, height = colour_size
        whole = (width, width * 3 // 4)  # the sensor is 4:3; narrower images show its middle
        beside = DepthCamera(_camera(depth, depth_size, *_DEPTH_MODES[depth_size], source), T_colour_depth)
        return _camera(colour, colour_size, *whole, 0, (whole[1] - height) // 2, source), beside
    except (ValueError, KeyError, TypeError, AttributeError, np.linalg.LinAlgError) as error:
        sizes = f"depth images of {depth_size[0]}x{depth_size[1]}"
        raise RecordingError(
            f"{source}: {type(error).__name__} {error}, expected the calibration of an Azure Kinect for {sizes}"
        ) from error


def _camera(camera: dict[str, Any], size: tuple[int, int], width: int, height: int, left: int, top: int, source: str) -> Calibration:
    """width, height: of the whole sensor; left, top: the first column and row of it that the images show [px]."""
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
