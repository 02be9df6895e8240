"""keyframes.json of a run: its camera, its keyframes, and those of the map that it started in."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.errors import ConfigError, ResultError
from idfslam.geometry.camera import Camera
from idfslam.runs.result_folder import KEYFRAMES, SCHEMA, existing
from idfslam.runs.run_config import RecordingSource, source_of
from idfslam.storage import atomic_files
from idfslam.storage.json_file import read_json
from idfslam.storage.plain_values import fits, shown


@dataclass(frozen=True, eq=False)
class EarlierKeyframe:
    """A keyframe of the map that a run started in."""

    source: RecordingSource  # the recording that holds its frame
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


def own_keyframes(record: KeyframeRecord, source: RecordingSource) -> list[EarlierKeyframe]:
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
    if not fits(values["index"], int) or not fits(values["timestamp"], float):
        raise ValueError(f"a keyframe of index {shown(values['index'])} at {shown(values['timestamp'])}")
    return EarlierKeyframe(source_of(values["source"], path), values["index"], values["timestamp"], T_wk, camera)
