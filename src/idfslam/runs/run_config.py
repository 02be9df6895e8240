"""config.yaml of a run: all values, the recording with the selection of its frames, and the versions of the packages."""

import platform
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_type_hints

import yaml

from idfslam import __version__
from idfslam.config import RUN_SECTIONS, Config, dump, load, read_yaml
from idfslam.errors import ResultError
from idfslam.runs.result_folder import CONFIG, existing
from idfslam.storage import atomic_files
from idfslam.storage.plain_values import fits, shown

_PACKAGES = ("torch", "numpy", "numba", "opencv-python-headless", "trimesh")


@dataclass(frozen=True)
class RecordingSource:
    """A recording and the selection of its frames: the arguments of `open_recording`."""

    path: str
    format: str | None = None
    camera: dict[str, float] | None = None  # fx, fy, cx, cy [px] that replace the recording's own
    camera_file: str | None = None  # whose values replace the recording's own too
    depth_scale: float | None = None  # units of the depth images per metre
    topics: dict[str, str] | None = None  # of a ROS recording; None: found by their types and names
    start: int = 0
    frames: int | None = None
    stride: int = 1
    truth: bool = True  # False leaves the ground truth unread


def write_config(folder: Path, config: Config, source: RecordingSource | None) -> None:
    """Writes config.yaml: all values, the recording, and the versions of the packages."""
    versions = {"idf-slam": __version__, "python": platform.python_version(), **{name: version(name) for name in _PACKAGES}}
    values = dump(config) | dict(zip(RUN_SECTIONS, (asdict(source) if source else None, versions)))
    with atomic_files.replacing(folder / CONFIG) as part:
        part.write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")


def read_config(folder: Path) -> tuple[Config, RecordingSource | None]:
    """Reads config.yaml. Raises ResultError if the folder holds no run, ConfigError if the file is damaged."""
    path = existing(folder, CONFIG)
    recording = read_yaml(path).get(RUN_SECTIONS[0])
    if recording is None:
        return load(path), None
    return load(path), source_of(recording, path)


def source_of(values: Any, path: Path) -> RecordingSource:
    """The source that values of a file state. Raises ResultError for other names, and for values of other types."""
    types = get_type_hints(RecordingSource)
    if not isinstance(values, dict) or "path" not in values or not values.keys() <= types.keys():
        raise ResultError(f"{path}: 'recording' is {shown(values)}, expected {', '.join(types)}")
    if wrong := [name for name, value in values.items() if not fits(value, types[name])]:
        raise ResultError(f"{path}: '{wrong[0]}' of the recording is {shown(values[wrong[0]])}, expected {types[wrong[0]]}")
    return RecordingSource(**values)
