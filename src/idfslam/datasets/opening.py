"""Opens recordings in common layouts. Each layout is one file in `readers/` (or `ros/`) and one line in READERS."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from idfslam.datasets import generated, input_summary
from idfslam.datasets.cameras.calibration import Calibration, given_values
from idfslam.datasets.cameras.camera_files import read_beside_recording, read_given
from idfslam.datasets.generated.kidnapped import Kidnapped
from idfslam.datasets.images import video
from idfslam.datasets.location import locate, without_scheme
from idfslam.datasets.near_miss import near_miss
from idfslam.datasets.readers import (
    array_recording,
    azure_kinect,
    bundle_fusion,
    folder,
    frame_lines,
    icl_nuim,
    polycam,
    record3d,
    replica,
    scanner_app,
    scannet,
    seven_scenes,
    stray_scanner,
    sun3d,
    transforms,
    tum,
    video_folder,
)
from idfslam.datasets.recalibrated import Recalibrated
from idfslam.datasets.recording import Dataset, Reader, Selection
from idfslam.datasets.recording_path import absolute
from idfslam.datasets.ros import reader as ros
from idfslam.datasets.topics import Topics
from idfslam.errors import ConfigError, RecordingError

log = logging.getLogger(__name__)

READERS: tuple[Reader, ...] = (  # in the order in which they are tried
    scannet.EXPORTED,
    scannet.RAW,
    replica.READER,
    bundle_fusion.READER,
    sun3d.READER,
    seven_scenes.READER,
    icl_nuim.READER,
    tum.READER,
    stray_scanner.READER,
    record3d.READER,
    azure_kinect.READER,
    transforms.READER,
    polycam.READER,
    scanner_app.READER,
    frame_lines.READER,
    video_folder.READER,
    folder.READER,
    array_recording.READER,
    ros.READER,
)
FORMATS = (*dict.fromkeys(reader.name for reader in READERS), *generated.NAMES)


def open_recording(
    path: Path | str,
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
    report: bool = True,
) -> Dataset:
    """Opens a recording in a common layout, recognised from its files, or a generated recording. Images are read on request.

    path: a folder, a file (.sens, .bag, .mcap, .mkv, .r3d, .mat, .h5), a zip or tar archive of a recording, a folder with one recording
        in it, a file or folder that is part of one, a file:// address, the name of a generated recording (`synthetic[:SEED][:kinect]`,
        `corridor[:SEED][:kinect][:Nlaps]`, or `:handheld` in place of `:kinect`: see `generated.handheld`), or `kidnap:` followed by one of
        these (see `generated.kidnapped`).
    format: one of FORMATS, if the layout is not recognised correctly.
    camera: any of fx, fy, cx, cy [px] and depth_scale; they override the recording's own values. All of fx, fy, cx, cy together mean a
        pinhole camera without distortion. field_of_view [degrees]: across the image, for a recording that states nothing of its camera.
    camera_file: a file like cam_params.json, whose values override the recording's own too; `camera` and `depth_scale` override it.
    depth_scale: units of the depth images per metre; overrides the recording's own value.
    topics: any of colour, depth, camera_info, poses: topics of a ROS recording; the others are detected.
    start, frames, stride: every stride-th frame from `start`, at most `frames` of them (None: all), numbered from 0.
    truth: False leaves the ground truth unread.
    report: log one line about what the recording was taken to be, and warn of what is implausible about it (see `input_summary`).

    Raises RecordingError if the recording as a whole cannot be used, ConfigError if an argument is out of range.
    """
    of_file = Calibration() if camera_file is None else read_given(absolute(without_scheme(camera_file)))
    given_calibration, given_topics = given_values(camera, depth_scale), Topics.of(topics)
    if format is not None and format not in FORMATS:
        raise ConfigError(f"format '{format}', expected one of {', '.join(FORMATS)}")
    if not str(path).strip():
        raise RecordingError(f"the path of the recording is empty, expected a recording, {generated.FORMS}")
    inner = generated.kidnapped_path(str(path))
    kind = format if format in generated.NAMES else generated.kind_of(str(path)) if format is None else None
    dataset: Dataset
    if inner is not None:
        options: dict[str, Any] = {"camera": camera, "camera_file": camera_file, "depth_scale": depth_scale}
        dataset = Kidnapped(open_recording(inner, format=format, **options, topics=topics, truth=truth, report=False))
    elif kind is not None:
        dataset = generated.open_generated(
            str(path), kind, given_calibration, length=0 if frames is None else start + (frames - 1) * stride + 1
        )
        dataset = dataset if camera_file is None else Recalibrated(dataset, of_file)
    else:
        dataset = _open_files(path, format, given_calibration.over(of_file), given_topics)
    selection = Selection(dataset, start=start, frames=frames, stride=stride, truth=truth)
    if report:
        input_summary.report(selection, dataset.timestamps)
        if frames is not None and frames > len(selection):
            log.warning("%s: %d frames asked for, all %d are taken", selection.name, frames, len(selection))
    return selection


def is_there(path: str) -> bool:
    """Whether a path is a file or folder, or the name of a generated recording."""
    inner = generated.kidnapped_path(path)
    if inner is not None:
        return is_there(inner)
    return generated.kind_of(path) is not None or absolute(without_scheme(path)).exists()


def _open_files(path: Path | str, format: str | None, calibration: Calibration, topics: Topics) -> Dataset:
    """The recording that lies in files at `path`."""
    file = absolute(without_scheme(path))
    try:
        place, reader = _find(file, format)
        return _open_with(reader, place, calibration.over(read_beside_recording(place)), topics)
    except OSError as error:
        raise RecordingError(f"{error.filename or file}: {error.strerror}, expected a readable recording") from error


def _open_with(reader: Reader, path: Path, calibration: Calibration, topics: Topics) -> Dataset:
    if topics == Topics():
        return reader.open(path, calibration)
    if reader.open_topics is None:
        raise ConfigError(f"{path}: topics are named, but a recording of layout {reader.name} has none: leave --topics out")
    return reader.open_topics(path, calibration, topics)


def _find(path: Path, format: str | None) -> tuple[Path, Reader]:
    """The recording that a path names, and its reader."""
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder, expected a recording, {generated.FORMS}")
    readers = [reader for reader in READERS if format in (None, reader.name)]
    folders = [reader for reader in readers if reader.likeness is not None]
    found = locate(path, lambda place: _recognise(place, readers), lambda place: _recognise(place, folders))
    if found is not None or format is not None:
        return found or (path, readers[0])
    content = ", ".join(sorted(entry.name for entry in path.iterdir())[:6]) if path.is_dir() else "a file"
    if path.suffix.lower() in video.SUFFIXES:
        raise RecordingError(f"{path}: a video without depth, expected a folder with it as rgb.mp4 and with depth images in depth/")
    if similar := near_miss(path, [reader.likeness for reader in READERS if reader.likeness is not None]):
        raise RecordingError(f"{path}: {similar}: found {content}")
    layouts = "; ".join(f"{reader.name} ({reader.layout})" for reader in READERS)
    raise RecordingError(f"{path}: not a known recording: found {content or 'an empty folder'}, expected one of {layouts}")


def _recognise(path: Path, readers: Sequence[Reader]) -> Reader | None:
    return next((reader for reader in readers if reader.recognises(path)), None)
