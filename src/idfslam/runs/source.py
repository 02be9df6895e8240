"""Opens what a run is made of: a recording or a live camera."""

import logging
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from idfslam.datasets import Dataset, Prefetch, open_recording
from idfslam.errors import RecordingError
from idfslam.frame import Frame
from idfslam.live import LiveStream, is_live, open_live
from idfslam.runs.run_config import RecordingSource

log = logging.getLogger(__name__)

_NAMED = 3  # unreadable frames of which each is a warning; raised, a damaged recording fills the console. Chosen by hand


def open_source(source: RecordingSource, *, report: bool = False) -> Dataset:
    """The recording that `source` names, with the frames that it selects. report: as in `open_recording`.

    Raises RecordingError or ConfigError.
    """
    return open_recording(**asdict(source), report=report)


def open_feed(source: RecordingSource) -> Dataset | LiveStream:
    """The recording or live camera that `source` names. Raises as `open_live` and `open_source` do."""
    if not is_live(source.path):
        return open_source(source, report=True)
    options = asdict(source)
    return open_live(options.pop("path"), **options)


def read_frames(recording: Dataset | LiveStream, source: RecordingSource | None = None, *, first: int = 0) -> Iterator[tuple[Frame, bool]]:
    """Each frame from index `first` on, read ahead, and whether it could be read. A blank frame replaces an unreadable one.

    The first unreadable frames are warnings of their own, the others are counted in one at the end, and so are frames without depth.
    Raises RecordingError if an unreadable frame is due to the recording's files being gone, which shows when `source` is an absolute path.
    """
    unreadable, without_depth = 0, 0
    for i, frame in recording if isinstance(recording, LiveStream) else Prefetch(recording, first=first):
        if isinstance(frame, Frame):
            without_depth += not frame.depth.any()
            yield frame, True
        elif source is not None and Path(source.path).is_absolute() and not Path(source.path).exists():
            raise RecordingError(f"{source.path}: is gone since frame {i}; bring it back, then continue with `idf-slam run --resume`")
        else:
            unreadable += 1
            if unreadable <= _NAMED:
                rest = "" if unreadable < _NAMED else "; further ones are counted at the end"
                log.warning("%s; the frame is treated as lost%s", frame, rest)
            yield Frame.blank(i, float(recording.timestamps[i]), recording.camera), False
    if without_depth:
        log.warning("%s: %d frames have no depth; frames.csv says how the pose of each was found", recording.name, without_depth)
    if unreadable > _NAMED:
        log.warning("%s: %d frames could not be read and are treated as lost", recording.name, unreadable)
