"""Random access to the frames of a video track. Frames in order are decoded one after the other, others from the key frame before them."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.images.image_header import LONGEST_SIDE
from idfslam.errors import ConfigError, FrameError, RecordingError, pip_install

SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm"})


def pyav() -> ModuleType:
    """The module PyAV; raises ConfigError if it is not installed."""
    try:
        import av
    except ImportError as error:
        raise ConfigError(f"reading video needs PyAV: {pip_install('av')}") from error
    return av


@dataclass(frozen=True)
class VideoContents:
    """The metadata of a video file."""

    titles: list[str]  # of the video tracks; "" where one has none
    formats: list[str]  # pixel formats of the video tracks, in ffmpeg's names
    tags: dict[str, str]
    attachments: dict[str, bytes]  # by file name


def read_contents(path: Path) -> VideoContents:
    """Reads a video file's metadata; raises RecordingError if the file is no video."""
    av = pyav()
    try:
        with av.open(str(path)) as container:
            tracks = container.streams.video
            files = {stream.metadata.get("filename", ""): bytes(stream.data) for stream in container.streams.attachments}
            titles, formats = [track.metadata.get("title", "") for track in tracks], [str(track.pix_fmt) for track in tracks]
            return VideoContents(titles, formats, dict(container.metadata), files)
    except _errors(av) as error:
        raise RecordingError(f"{path}: not a readable video ({_reason(error)}): copy the recording again") from error


def _errors(av: ModuleType) -> tuple[type[Exception], ...]:
    """What PyAV raises for damaged files: ffmpeg's errors, and Python's for texts, sizes, decoders and time bases that are none."""
    return (av.FFmpegError, ValueError, TypeError, AttributeError, OverflowError, ZeroDivisionError, MemoryError)


class VideoTrack:
    """Frames 0 to N - 1 of a video track in the order of display, not rotated. Threads may share it; they are served one at a time.

    Opening reads the stamps of all frames and decodes none. Raises RecordingError if the file has no such track.
    """

    def __init__(self, path: Path, track: int = 0) -> None:
        """track: the number of the track among the file's video tracks."""
        self.path, self._track = path, track
        self._lock = threading.Lock()
        av = pyav()
        self._errors = _errors(av)
        stamps: dict[int, bool] = {}  # stamp in the track's time base -> whether it is a key frame
        try:
            self._container = av.open(str(path))
            if track >= len(self._container.streams.video):
                raise RecordingError(f"{path}: {len(self._container.streams.video)} video tracks, expected at least {track + 1}")
            self._stream = self._container.streams.video[track]
            for packet in self._container.demux(self._stream):
                if packet.pts is not None and packet.size and not packet.is_discard:
                    stamps[packet.pts] = packet.is_keyframe
            second = float(self._stream.time_base)
            self.size: tuple[int, int] = (self._stream.width, self._stream.height)  # [px]
        except self._errors as error:
            raise RecordingError(f"{path}: not a readable video ({_reason(error)}): copy the recording again") from error
        if not all(0 < side <= LONGEST_SIDE for side in self.size):
            size = f"{self.size[0]}x{self.size[1]}"
            raise RecordingError(f"{path}: video track {track} is {size}, expected 1 to {LONGEST_SIDE} pixels a side: copy it again")
        if not stamps:
            raise RecordingError(f"{path}: video track {track} holds no frames with stamps, expected a video: copy the recording again")
        self._stamps = np.array(sorted(stamps), np.int64)
        self._keys = np.flatnonzero([stamps[stamp] for stamp in self._stamps.tolist()])
        self.times = np.array(self._stamps * second, np.float64)  # (N,) [s]
        self._frames: Iterator[Any] = iter(())
        self._next = len(self)  # the frame that the decoder returns next

    def __len__(self) -> int:
        return len(self._stamps)

    def colour(self, i: int, size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
        """Frame i (H, W, 3) BGR, scaled to `size` (width, height) by means over areas (None: not scaled); raises FrameError."""
        width, height = size or self.size
        return np.asarray(self._array(i, format="bgr24", width=width, height=height, interpolation="AREA"), np.uint8)

    def grey16(self, i: int) -> NDArray[np.uint16]:
        """Frame i (H, W) of a track of 16-bit grey images; raises FrameError."""
        frame = self._decoded(i)
        if not frame.format.name.startswith("gray16"):
            raise FrameError(f"{self.path}: video track {self._track} holds {frame.format.name} images, expected depth as 16-bit grey")
        return np.asarray(self._array(i, frame), np.uint16)

    def _array(self, i: int, frame: Any = None, **options: Any) -> NDArray[Any]:
        """The pixels of frame i, which may be decoded already."""
        frame = self._decoded(i) if frame is None else frame
        try:
            return np.asarray(frame.to_ndarray(**options))
        except self._errors as error:
            reason = _reason(error)
            raise FrameError(f"{self.path}: frame {i} of video track {self._track}: {reason}: copy the recording again") from error

    def _decoded(self, i: int) -> Any:
        with self._lock:
            try:
                if not self._next <= i or self._key_before(i) > self._next:
                    self._seek(i)
                for frame in self._frames:
                    if frame.pts is None or frame.pts < self._stamps[i]:
                        continue
                    if frame.pts > self._stamps[i]:
                        break
                    self._next = i + 1
                    return frame
                reason = "it cannot be decoded"
            except self._errors as error:
                reason = _reason(error)
            self._next = len(self)  # the decoder's position is unknown now
            raise FrameError(f"{self.path}: frame {i} of video track {self._track}: {reason}: copy the recording again")

    def _key_before(self, i: int) -> int:
        k = np.searchsorted(self._keys, i, side="right") - 1
        return int(self._keys[k]) if k >= 0 else 0

    def _seek(self, i: int) -> None:
        self._container.seek(int(self._stamps[self._key_before(i)]), stream=self._stream, backward=True)
        self._frames = self._container.decode(self._stream)


def _reason(error: Exception) -> str:
    """ffmpeg's message without the file's name and the log."""
    lines = str(getattr(error, "strerror", None) or error).splitlines()
    return lines[0] if lines else type(error).__name__
