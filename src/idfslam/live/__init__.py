"""Live cameras, each by a name: `realsense`, `opencv:0:2`. A driver is one file beside this one and one line in DRIVERS."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

from idfslam.datasets import generated
from idfslam.datasets.calibration import Calibration, override
from idfslam.errors import ConfigError
from idfslam.live.depth_camera import Capture, DepthCamera
from idfslam.live.stream import LiveStream

__all__ = ["NAMES", "Capture", "DepthCamera", "LiveStream", "is_live", "located", "open_camera", "open_live", "replayed"]

NAMES = "realsense[:SERIAL or FILE], opencv:COLOUR:DEPTH, openni[:NUMBER], orbbec[:NUMBER], replay[@SPEED]:PATH"
_NAME = re.compile(r"(?P<driver>realsense|opencv|openni|orbbec|replay)(?:@(?P<speed>[^:]*))?(?::(?P<rest>.*))?")


def is_live(name: str) -> bool:
    """Whether a source's name is that of a live camera and not of something that lies there."""
    return _NAME.fullmatch(name) is not None and not Path(name).exists()


def replayed(name: str) -> str | None:
    """The recording that `replay` plays, empty where it is not said; None for a camera."""
    found = _NAME.fullmatch(name)
    return found["rest"] or "" if found and found["driver"] == "replay" else None


def located(name: str) -> str:
    """The name of a source with its path made absolute, so that it is found again from anywhere."""
    found = _NAME.fullmatch(name) if is_live(name) else None
    path = name if found is None else found["rest"] or "" if found["driver"] in ("replay", "realsense") else ""
    return name.removesuffix(path) + generated.located(path) if path else name


def open_live(
    name: str,
    *,
    format: str | None = None,
    camera: Mapping[str, float | None] | None = None,
    depth_scale: float | None = None,
    topics: Mapping[str, str | None] | None = None,
    start: int = 0,
    frames: int | None = None,
    stride: int = 1,
) -> LiveStream:
    """A live camera by its name (see NAMES), as a stream that ends after `frames` frames, or as `open_recording` has them.

    format, topics, start and stride are those of the recording that `replay` plays.
    Raises CameraError where the camera is not there, ConfigError where name or arguments are wrong, RecordingError where the camera is
    unknown and where a recording to replay cannot be used.
    """
    if frames is not None and frames < 1:
        raise ConfigError(f"frames {frames}, expected at least 1")
    given = override(camera, depth_scale)
    path = replayed(name)
    if path is None:
        if format is not None or topics or start or stride != 1:
            raise ConfigError(f"{name}: a camera has no first frame, layout and topics: leave --start, --stride, --format and --topics out")
        return LiveStream(open_camera(name, given), frames=frames)
    if not path:
        raise ConfigError(f"{name}: expected replay:PATH, with a recording in any layout or synthetic[:SEED][:kinect]")
    from idfslam.datasets import open_recording
    from idfslam.live.replay import Replay

    speed = _speed(name)
    recording = open_recording(path, format=format, camera=camera, depth_scale=depth_scale, topics=topics, start=start, stride=stride)
    return LiveStream(Replay(recording, speed=speed), frames=frames)


def open_camera(name: str, given: Calibration) -> DepthCamera:
    """The camera of a driver; `given` is what the user says of it. Raises as `open_live`."""
    found = _NAME.fullmatch(name)
    if found is None or found["speed"] is not None:
        raise ConfigError(f"{name}: not a live camera, expected one of {NAMES}")
    return DRIVERS[found["driver"]](found["rest"] or "", given)


def _speed(name: str) -> float:
    found = _NAME.fullmatch(name)
    text = found["speed"] if found else None
    if text is None:
        return 1.0
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed < float("inf"):
        raise ConfigError(f"{name}: speed '{text}', expected a number above 0: replay@0.5:PATH plays at half speed")
    return speed


def _realsense(which: str, given: Calibration) -> DepthCamera:
    from idfslam.live.realsense import RealSense

    if given != Calibration():
        raise ConfigError("realsense: the device tells its own camera and depth scale, expected no override: leave the camera's values out")
    return RealSense(which)


def _opencv(which: str, given: Calibration) -> DepthCamera:
    from idfslam.live.opencv import open_pair

    colour, _, depth = which.partition(":")
    if not colour or not depth:
        raise ConfigError(f"opencv:{which}: expected opencv:COLOUR:DEPTH with two video devices, such as opencv:0:2")
    return open_pair(colour, depth, given)


def _depth_device(kind: str) -> Callable[[str, Calibration], DepthCamera]:
    def opened(number: str, given: Calibration) -> DepthCamera:
        from idfslam.live.opencv import open_device

        if not (number or "0").isdecimal():
            raise ConfigError(f"{kind}:{number}: expected the number of a device, such as {kind}:0")
        return open_device(kind, number or "0", given)

    return opened


DRIVERS: dict[str, Callable[[str, Calibration], DepthCamera]] = {
    "realsense": _realsense,
    "opencv": _opencv,
    "openni": _depth_device("openni"),
    "orbbec": _depth_device("orbbec"),
}
