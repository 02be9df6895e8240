"""The files in the result folder of a run. Each is written whole or not at all."""

import platform
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import yaml
from numpy.typing import NDArray

from idfslam import __version__
from idfslam.config import RUN_SECTIONS, Config, dump, load, read_yaml
from idfslam.errors import ConfigError, ResultError
from idfslam.evaluation import files as evaluation_files
from idfslam.geometry.camera import Camera
from idfslam.storage import atomic_files
from idfslam.storage.json_file import read_json
from idfslam.storage.ledger import Ledger
from idfslam.storage.plain_values import shown
from idfslam.viewer.rerun_program import RECORDING as RECORDING

TRAJECTORY, LIVE, MESH, MAP = "trajectory.txt", "live_trajectory.txt", "mesh.ply", "map.safetensors"
KEYFRAMES, CONFIG, METRICS, PICTURE = "keyframes.json", "config.yaml", "metrics.json", evaluation_files.TRAJECTORY_PICTURE
ARCHIVE, FRAMES, REPORT, SCENE, PICTURES = "archive.safetensors", "frames.csv", "report.html", "scene.html", "pictures"
CHECKPOINT = "checkpoint.safetensors"  # of an unfinished run
FILES = (
    TRAJECTORY,
    LIVE,
    MESH,
    MAP,
    ARCHIVE,
    KEYFRAMES,
    CONFIG,
    METRICS,
    FRAMES,
    PICTURE,
)  # of a run
EVALUATION, EVALUATION_FILES = evaluation_files.EVALUATION, evaluation_files.FILES
_PICTURE = re.compile(r"(trajectory|error|frames|stages|losses|mesh|inside|view|slice|moving)(_[0-9a-z_]+)?\.png")  # a picture of a report
SCHEMA = 1  # of keyframes.json and metrics.json; counts up when a reader of the older form would misread a file
_PACKAGES = ("torch", "numpy", "numba", "opencv-python-headless", "trimesh")


@dataclass(frozen=True)
class Source:
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


@dataclass(frozen=True, eq=False)
class EarlierKeyframe:
    """A keyframe of the map that a run started in."""

    source: Source  # the recording that holds its frame
    index: int  # of the frame in that recording
    timestamp: float  # [s]
    T_wk: NDArray[np.float64]  # (4, 4)
    camera: Camera | None  # None: the file is of an older version, which did not store it


@dataclass(frozen=True, eq=False)
class KeyframeRecord:
    """The content of keyframes.json."""

    camera: Camera  # of the run's own recording
    indices: NDArray[np.int64]  # (K,) frames of the trajectory
    timestamps: NDArray[np.float64]  # (K,) [s]
    poses: NDArray[np.float64]  # (K, 4, 4) T_wk
    earlier: Sequence[EarlierKeyframe] = ()  # the keyframes of the map that the run started in
    covariances: Sequence[NDArray[np.float64] | None] = ()  # of each pose, as in `StoredKeyframe`; empty: none is known


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turns an OSError of the `with` block, such as a full disk or a removed folder, into a ResultError."""
    try:
        yield
    except OSError as error:
        advice = f"make room or give permission, then continue from the last checkpoint with `idf-slam run --resume {folder}`"
        raise ResultError(f"{error.filename or folder}: cannot be written ({error.strerror or error}); {advice}") from error


def ledger(folder: Path) -> Ledger:
    """The ledger of a result folder. In one without (a copy without hidden files, an older version) the files of a run count as its own."""
    found = Ledger(folder)
    if not found.marks and all((folder / name).is_file() for name in (TRAJECTORY, KEYFRAMES, CONFIG)):
        found.record([name for name in FILES if (folder / name).is_file()])
    return found


def report_files(folder: Path) -> set[str]:
    """The names of report.html, of scene.html and of the files in pictures/ that are named as a report's pictures."""
    pictures = {f"{PICTURES}/{path.name}" for path in (folder / PICTURES).glob("*.png") if _PICTURE.fullmatch(path.name)}
    return {REPORT, SCENE, *pictures}


def write_config(folder: Path, config: Config, source: Source | None) -> None:
    """Writes config.yaml: all values, the recording, and the versions of the packages."""
    versions = {"idf-slam": __version__, "python": platform.python_version(), **{name: version(name) for name in _PACKAGES}}
    values = dump(config) | dict(zip(RUN_SECTIONS, (asdict(source) if source else None, versions)))
    with atomic_files.replacing(folder / CONFIG) as part:
        part.write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")


def read_config(folder: Path) -> tuple[Config, Source | None]:
    """Reads config.yaml. Raises ResultError if the folder holds no run, ConfigError if the file is damaged."""
    path = existing(folder, CONFIG)
    recording = read_yaml(path).get(RUN_SECTIONS[0])
    if recording is None:
        return load(path), None
    return load(path), _source(recording, path)


def _source(values: Any, path: Path) -> Source:
    """The source that values of a file state. Raises ResultError for other names, and for values of other types."""
    types = get_type_hints(Source)
    if not isinstance(values, dict) or "path" not in values or not values.keys() <= types.keys():
        raise ResultError(f"{path}: 'recording' is {shown(values)}, expected {', '.join(types)}")
    if wrong := [name for name, value in values.items() if not _fits(value, types[name])]:
        raise ResultError(f"{path}: '{wrong[0]}' of the recording is {shown(values[wrong[0]])}, expected {types[wrong[0]]}")
    return Source(**values)


def _fits(value: Any, expected: Any) -> bool:
    """Whether a value is of a type, of one of several, or a mapping of such."""
    if isinstance(expected, UnionType):
        return any(_fits(value, one) for one in get_args(expected))
    if get_origin(expected) is dict:
        of_names, of_values = get_args(expected)
        return isinstance(value, dict) and all(_fits(name, of_names) and _fits(inner, of_values) for name, inner in value.items())
    if expected in (int, float):
        return isinstance(value, int | expected) and not isinstance(value, bool)
    return isinstance(value, expected)


def write_keyframes(folder: Path, record: KeyframeRecord) -> None:
    """Writes keyframes.json: the camera, and for each keyframe its frame, time stamp [s], pose T_wk (4 x 4, by rows) and its covariance.

    The keyframes of the map that the run started in are in a list of their own. Each has its recording and its camera as well.
    """
    keyframes: list[dict[str, Any]] = [
        {"index": int(i), "timestamp": float(t), "T_wk": T_wk.tolist()}
        for i, t, T_wk in zip(record.indices, record.timestamps, record.poses, strict=True)
    ]
    for keyframe, covariance in zip(keyframes, record.covariances):
        if covariance is not None:
            keyframe["covariance"] = covariance.tolist()
    earlier = [asdict(keyframe) for keyframe in record.earlier]
    values = {"schema": SCHEMA, "camera": asdict(record.camera), "keyframes": keyframes} | ({"earlier": earlier} if earlier else {})
    atomic_files.write_json(folder / KEYFRAMES, values)


def own_keyframes(record: KeyframeRecord, source: Source) -> list[EarlierKeyframe]:
    """The keyframes of a run, as an extension of its map stores them."""
    columns = zip(record.indices, record.timestamps, record.poses, strict=True)
    return [EarlierKeyframe(source, int(index), float(stamp), T_wk, record.camera) for index, stamp, T_wk in columns]


def read_keyframes(folder: Path) -> KeyframeRecord:
    """Reads keyframes.json. Raises ResultError if it is missing or damaged."""
    path = existing(folder, KEYFRAMES)
    try:
        values = read_json(path, error=ResultError, expected="the keyframes of a run: run again into this folder")
        keyframes = values["keyframes"]
        return KeyframeRecord(
            Camera(**values["camera"]),
            np.array([k["index"] for k in keyframes], np.int64),
            np.array([k["timestamp"] for k in keyframes], np.float64),
            np.array([k["T_wk"] for k in keyframes], np.float64).reshape(-1, 4, 4),
            [_earlier_keyframe(k, path) for k in values.get("earlier", [])],
            [np.array(k["covariance"], np.float64).reshape(6, 6) if "covariance" in k else None for k in keyframes],
        )
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, ConfigError) as error:
        raise ResultError(f"{path}: is damaged ({error}); run again into this folder") from error


def _earlier_keyframe(values: dict[str, Any], path: Path) -> EarlierKeyframe:
    camera = Camera(**values["camera"]) if values.get("camera") else None
    T_wk = np.array(values["T_wk"], np.float64).reshape(4, 4)
    if not _fits(values["index"], int) or not _fits(values["timestamp"], float):
        raise ValueError(f"a keyframe of index {shown(values['index'])} at {shown(values['timestamp'])}")
    return EarlierKeyframe(_source(values["source"], path), values["index"], values["timestamp"], T_wk, camera)


def existing(folder: Path, name: str) -> Path:
    """The path of a result file. Raises ResultError if it does not exist."""
    path = folder / name
    if not folder.is_dir():
        raise ResultError(f"{folder}: no such folder; expected the results of `idf-slam run`")
    if not path.is_file():
        found = ", ".join(f for f in FILES if (folder / f).is_file()) or "no result file at all"
        raise ResultError(f"{folder}: has no {name} (found {found}); expected the results of a finished `idf-slam run`")
    return path
