"""What a run is, or was, made of, opened: a recording, or a live camera."""

from dataclasses import asdict

from idfslam.datasets import Dataset, open_recording
from idfslam.live import LiveStream, is_live, open_live
from idfslam.runs.result_folder import Source


def open_source(source: Source) -> Dataset:
    """The recording and the frames of it that a run was, or is to be, made of. Raises RecordingError or ConfigError."""
    return open_recording(**asdict(source))


def open_feed(source: Source) -> Dataset | LiveStream:
    """What a run is to be made of: a live camera, or else a recording. Raises as `open_live` and `open_source`."""
    if not is_live(source.path):
        return open_source(source)
    options = asdict(source)
    return open_live(options.pop("path"), **options)
