"""The map and keyframes of an earlier run, in which a new recording is localised and which it extends."""

import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from idfslam.datasets import Dataset
from idfslam.errors import FrameError, RecordingError, ResultError
from idfslam.frame import Frame
from idfslam.mapping.saved_map import SavedMap, load_map
from idfslam.runs import result_folder
from idfslam.runs.source import open_source

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class PriorKeyframe:
    """A keyframe of an earlier run: its frame, its pose, and the recording of its frame."""

    frame: Frame
    T_wk: torch.Tensor  # (4, 4) float64
    record: result_folder.EarlierKeyframe


@dataclass(frozen=True, eq=False)
class PriorMap:
    """The map that a run starts in."""

    folder: Path
    saved: SavedMap
    keyframes: Sequence[PriorKeyframe]


def load_prior(folder: Path) -> PriorMap:
    """Loads the map of a result folder and its keyframes. Their images are read again from their recordings.

    Raises ResultError if the folder holds no finished run, or if no keyframe's recording can be read.
    """
    saved = load_map(result_folder.existing(folder, result_folder.MAP))
    _, source = result_folder.read_config(folder)
    record = result_folder.read_keyframes(folder)
    own = [] if source is None else result_folder.own_keyframes(record, source)
    found = [*_read([*record.earlier, *own])]
    if not found:
        raise ResultError(f"{folder}: none of its keyframes' images can be read again; expected its recording where it was ({source})")
    return PriorMap(folder, saved, found)


def _read(records: Sequence[result_folder.EarlierKeyframe]) -> list[PriorKeyframe]:
    """The keyframes whose images can be read; each recording is opened once."""
    opened: dict[str, Dataset | None] = {}
    found = []
    for record in records:
        key = str(asdict(record.source))
        if key not in opened:
            opened[key] = _opened(record.source)
        recording = opened[key]
        if recording is None:
            continue
        try:
            frame = recording[record.index]
        except (FrameError, IndexError) as error:
            log.warning("%s; the keyframe is left out", error)
            continue
        found.append(PriorKeyframe(frame, torch.from_numpy(record.T_wk), record))
    return found


def _opened(source: result_folder.Source) -> Dataset | None:
    try:
        return open_source(source)
    except RecordingError as error:
        log.warning("%s; its keyframes are left out", error)
        return None
