"""Recordings in the layouts of the field, opened lazily. A layout is one file beside this one and one line in READERS."""

import os
import re
from collections.abc import Mapping
from pathlib import Path

from idfslam.datasets import azure_kinect, folder, icl_nuim, record3d, replica, ros, scannet, seven_scenes, stray_scanner, tum, video_folder
from idfslam.datasets.calibration import Calibration, override
from idfslam.datasets.prefetch import Prefetch
from idfslam.datasets.recording import Dataset, Reader, Recording, Selection
from idfslam.datasets.topics import Topics
from idfslam.errors import ConfigError, RecordingError

__all__ = ["FORMATS", "Dataset", "Prefetch", "Recording", "Selection", "open_recording"]

_SYNTHETIC = re.compile(r"synthetic(?::(?P<seed>\d+))?(?P<noise>:kinect)?")

READERS: tuple[Reader, ...] = (  # in the order in which they are tried
    scannet.READER,
    replica.READER,
    seven_scenes.READER,
    icl_nuim.READER,
    tum.READER,
    stray_scanner.READER,
    record3d.READER,
    azure_kinect.READER,
    video_folder.READER,
    folder.READER,
    ros.READER,
)
FORMATS = (*(reader.name for reader in READERS), "synthetic")


def open_recording(
    path: Path | str,
    *,
    format: str | None = None,
    camera: Mapping[str, float | None] | None = None,
    depth_scale: float | None = None,
    topics: Mapping[str, str | None] | None = None,
    start: int = 0,
    frames: int | None = None,
    stride: int = 1,
) -> Dataset:
    """Opens a recording, recognised by what lies in it, or generates one: `synthetic[:SEED][:kinect]`.

    path: a folder, a file (.sens, .bag, .mcap, .mkv, .r3d), or the name of a synthetic room.
    format: one of FORMATS, where the layout is not recognised or is mistaken for another.
    camera: any of fx, fy, cx, cy [px] (and depth_scale), over what the recording says. All four together state the pinhole
        camera of the images as they are, without distortion.
    depth_scale: units of the depth images per metre, over what the recording says.
    topics: any of colour, depth, camera_info, poses: the topics of a ROS recording, where they are not found by themselves.
    start, frames, stride: every stride-th frame from `start`, `frames` of them (all that there are if None), numbered from 0.

    Raises RecordingError where the recording as a whole cannot be used, ConfigError where an argument is out of range.
    """
    given, named = override(camera, depth_scale), Topics.of(topics)
    if format is not None and format not in FORMATS:
        raise ConfigError(f"format '{format}', expected one of {', '.join(FORMATS)}")
    if format == "synthetic" or (format is None and _SYNTHETIC.fullmatch(str(path)) and not Path(path).exists()):
        dataset = _open_synthetic(str(path), given, length=0 if frames is None else start + (frames - 1) * stride + 1)
    else:
        place = Path(os.path.abspath(Path(path).expanduser()))  # a name even for "."
        try:
            dataset = _open(_reader(place, format), place, given, named)
        except OSError as error:
            raise RecordingError(f"{error.filename or place}: {error.strerror}, expected a readable recording") from error
    return Selection(dataset, start=start, frames=frames, stride=stride)


def _open(reader: Reader, path: Path, given: Calibration, named: Topics) -> Dataset:
    if named == Topics():
        return reader.open(path, given)
    if reader.open_topics is None:
        raise ConfigError(f"{path}: topics are named, but a recording of layout {reader.name} has none: leave --topics out")
    return reader.open_topics(path, given, named)


def _reader(path: Path, format: str | None) -> Reader:
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder, expected a recording or synthetic[:SEED][:kinect]")
    if format is not None:
        return next(reader for reader in READERS if reader.name == format)
    for reader in READERS:
        if reader.recognises(path):
            return reader
    content = ", ".join(sorted(entry.name for entry in path.iterdir())[:6]) if path.is_dir() else "a file"
    layouts = "; ".join(f"{reader.name} ({reader.layout})" for reader in READERS)
    raise RecordingError(f"{path}: not a known recording: found {content or 'an empty folder'}, expected one of {layouts}")


def _open_synthetic(path: str, given: Calibration, length: int) -> Dataset:
    """One tour of the room, or as many frames as are asked for where that is longer."""
    from idfslam.datasets.synthetic import TOUR, SyntheticRoom  # compiles its ray caster: only where it is asked for

    name = _SYNTHETIC.fullmatch(path)
    if name is None:
        raise RecordingError(f"{path}: not a synthetic room, expected synthetic[:SEED][:kinect]")
    if given != Calibration():
        raise ConfigError(f"{path}: a synthetic room has its own camera and depth, expected no override: leave the camera's values out")
    return SyntheticRoom(seed=int(name["seed"] or 0), frames=max(TOUR, length), noise=name["noise"] is not None)
