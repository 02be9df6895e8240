"""Live cameras, opened by name: `realsense`, `opencv:0:2`. A driver is one file in this package and one line in DRIVERS."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from idfslam.datasets import generated
from idfslam.datasets.cameras.calibration import Calibration, given_values
from idfslam.datasets.cameras.camera_files import read_given
from idfslam.errors import ConfigError
from idfslam.live.depth_camera import Capture, DepthCamera
from idfslam.live.stream import LiveStream

__all__ = ["NAMES", "Capture", "DepthCamera", "LiveStream", "absolute_path", "is_live", "open_camera", "open_live", "replayed_path"]

NAMES = "realsense[:SERIAL or FILE], opencv:COLOUR:DEPTH, openni[:NUMBER], orbbec[:NUMBER], replay[@SPEED]:PATH"
_NAME = re.compile(r"(?P<driver>realsense|opencv|openni|orbbec|replay)(?:@(?P<speed>[^:]*))?(?::(?P<rest>.*))?")


def is_live(name: str) -> bool:
    """Whether a source's name is that of a live camera, and no file has this name."""
    return _NAME.fullmatch(name) is not None and not Path(name).exists()


def replayed_path(name: str) -> str | None:
    """The path of the recording that `replay` plays, empty if there is none in the name; None for a camera."""
    match = _NAME.fullmatch(name)
    return match["rest"] or "" if match and match["driver"] == "replay" else None


def absolute_path(name: str) -> str:
    """The name of a source with its path, if it has one, made absolute, so that it is valid in any folder."""
    match = _NAME.fullmatch(name) if is_live(name) else None
    path = name if match is None else match["rest"] or "" if match["driver"] in ("replay", "realsense") else ""
    return name.removesuffix(path) + generated.absolute_path(path) if path else name


def open_live(
    name: str,
    *,
    format: str | None = None,
    camera: Mapping[str, float | None] | None = None,
    camera_file: Path | str | None = None,
    depth_scale: float | None = None,
    topics: Mapping[str, str | None] | None = None,
    start: int = 0,
    frames: int | None = None,
    stride: int = 1,
    truth: bool = True,
) -> LiveStream:
    """Opens a live camera by its name (see NAMES), as a stream of at most `frames` frames (None: no limit).

    The other arguments are those of `open_recording`; format, topics, start and stride apply only to the recording that `replay` plays.
    Raises CameraError if the camera is not connected, ConfigError if name or arguments are wrong, RecordingError if the camera's
    intrinsics are unknown or a recording to replay cannot be used.
    """
    if frames is not None and frames < 1:
        raise ConfigError(f"frames {frames}, expected at least 1")
    of_file = Calibration() if camera_file is None else read_given(Path(camera_file))
    calibration = given_values(camera, depth_scale).over(of_file)
    path = replayed_path(name)
    if path is None:
        if format is not None or topics or start or stride != 1:
            raise ConfigError(f"{name}: a camera has no first frame, layout and topics: leave --start, --stride, --format and --topics out")
        if calibration.reach is not None:
            raise ConfigError(f"{name}: the reach of a camera is set in its driver: leave --camera.reach out")
        return LiveStream(open_camera(name, calibration), frames=frames)
    if not path:
        raise ConfigError(f"{name}: expected replay:PATH, with a recording in any layout or synthetic[:SEED][:kinect]")
    from idfslam.datasets import open_recording
    from idfslam.live.playback import Playback

    speed = _speed(name)
    values: dict[str, Any] = {"camera": camera, "camera_file": camera_file, "depth_scale": depth_scale}
    recording = open_recording(path, format=format, **values, topics=topics, start=start, stride=stride, truth=truth)
    return LiveStream(Playback(recording, speed=speed), frames=frames)


def open_camera(name: str, calibration: Calibration) -> DepthCamera:
    """Opens a camera with its driver; `calibration` has the user's values. Raises as `open_live`."""
    match = _NAME.fullmatch(name)
    if match is None or match["speed"] is not None:
        raise ConfigError(f"{name}: not a live camera, expected one of {NAMES}")
    return DRIVERS[match["driver"]](match["rest"] or "", calibration)


def _speed(name: str) -> float:
    match = _NAME.fullmatch(name)
    text = match["speed"] if match else None
    if text is None:
        return 1.0
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed < float("inf"):
        raise ConfigError(f"{name}: speed '{text}', expected a number above 0: replay@0.5:PATH plays at half speed")
    return speed


def _realsense(which: str, calibration: Calibration) -> DepthCamera:
    from idfslam.live.realsense import RealSense

    if calibration != Calibration().with_times(calibration.timing()):
        raise ConfigError("realsense: the device tells its own camera and depth scale: leave the camera's values out")
    return RealSense(which, calibration)


def _opencv(which: str, calibration: Calibration) -> DepthCamera:
    from idfslam.live.opencv import open_pair

    colour, _, depth = which.partition(":")
    if not colour or not depth:
        raise ConfigError(f"opencv:{which}: expected opencv:COLOUR:DEPTH with two video devices, such as opencv:0:2")
    return open_pair(colour, depth, calibration)


def _depth_device(kind: str) -> Callable[[str, Calibration], DepthCamera]:
    def open_numbered(number: str, calibration: Calibration) -> DepthCamera:
        from idfslam.live.opencv import open_device

        if not (number or "0").isdecimal():
            raise ConfigError(f"{kind}:{number}: expected the number of a device, such as {kind}:0")
        return open_device(kind, number or "0", calibration)

    return open_numbered


DRIVERS: dict[str, Callable[[str, Calibration], DepthCamera]] = {
    "realsense": _realsense,
    "opencv": _opencv,
    "openni": _depth_device("openni"),
    "orbbec": _depth_device("orbbec"),
}
