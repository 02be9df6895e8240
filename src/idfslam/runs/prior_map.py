"""The map and keyframes of an earlier run, in which a new recording is localised and which it extends."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch

from idfslam.datasets import Dataset
from idfslam.errors import FrameError, RecordingError, ResultError
from idfslam.frame import Frame
from idfslam.mapping.saved_map import SavedMap, load_map
from idfslam.runs import result_folder
from idfslam.runs.keyframes_file import EarlierKeyframe, own_keyframes, read_keyframes
from idfslam.runs.run_config import read_config
from idfslam.runs.source import open_source
from idfslam.views.image_archive import ImageArchive, load_archive

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class PriorKeyframe:
    """A keyframe of an earlier run: its frame, its pose, and the recording of its frame."""

    frame: Frame
    T_wk: torch.Tensor  # (4, 4) float64
    record: EarlierKeyframe


@dataclass(frozen=True, eq=False)
class PriorMap:
    """The map that a run starts in."""

    folder: Path
    saved: SavedMap
    keyframes: Sequence[PriorKeyframe]
    archive: ImageArchive | None = None  # the images that its views are made of


def load_prior(folder: Path) -> PriorMap:
    """Loads the map of a result folder and its keyframes. Their images are read again from their recordings.

    Raises ResultError if the folder holds no finished run, or if no keyframe's recording can be read.
    """
    saved = load_map(result_folder.existing(folder, result_folder.MAP))
    _, source = read_config(folder)
    record = read_keyframes(folder)
    own = [] if source is None else own_keyframes(record, source)
    found = [*earlier_keyframes([*record.earlier, *own])]
    if not found:
        raise ResultError(f"{folder}: none of its keyframes' images can be read again; expected its recording where it was ({source})")
    path = folder / result_folder.ARCHIVE
    return PriorMap(folder, saved, found, load_archive(path) if path.is_file() else None)


def earlier_keyframes(records: Sequence[EarlierKeyframe]) -> Iterator[PriorKeyframe]:
    """Yields the keyframes whose images can be read, each with the camera of its recording. Each recording is opened once."""
    opened: dict[str, Dataset | None] = {}
    for record in records:
        key = str(asdict(record.source))
        if key not in opened:
            opened[key] = _opened(record)
        recording = opened[key]
        if recording is None:
            continue
        try:
            frame = recording[record.index]
        except (FrameError, IndexError) as error:
            log.warning("%s; the keyframe is left out", error)
            continue
        yield PriorKeyframe(frame, torch.from_numpy(record.T_wk), replace(record, camera=frame.camera))


def _opened(keyframe: EarlierKeyframe) -> Dataset | None:
    """The recording of a keyframe. None, with a warning, if it cannot be read or its camera is not the keyframe's."""
    try:
        recording = open_source(keyframe.source)
    except RecordingError as error:
        log.warning("%s; its keyframes are left out", error)
        return None
    if keyframe.camera is not None and recording.camera != keyframe.camera:
        found, expected = (
            f"{camera.width}x{camera.height}, focal lengths {camera.fx:g} and {camera.fy:g} px"
            for camera in (recording.camera, keyframe.camera)
        )
        log.warning("%s: has a camera of %s; its keyframes are of %s, and are left out", keyframe.source.path, found, expected)
        return None
    return recording
