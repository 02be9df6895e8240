"""Records a live camera into a plain folder (`datasets/readers/folder.py`), readable at any time up to the last complete frame."""

import errno
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.compute.interrupt import stop_on_interrupt
from idfslam.datasets.cameras.calibration import TIMES
from idfslam.datasets.cameras.camera_files import CAM_PARAMS
from idfslam.datasets.images.decoding import SATURATED
from idfslam.datasets.readers.folder import COLOUR_FOLDERS
from idfslam.datasets.stamps import HEADER, STAMPS
from idfslam.errors import ResultError
from idfslam.frame import Frame
from idfslam.live import LiveStream
from idfslam.storage import atomic_files

log = logging.getLogger(__name__)

_COLOUR, _DEPTH, _INTRINSICS = COLOUR_FOLDERS[0], "depth", "intrinsics.txt"
_UNITS = 1000  # units of depth per metre
_ENCODING = {".jpg": [cv2.IMWRITE_JPEG_QUALITY, 95], ".png": [cv2.IMWRITE_PNG_COMPRESSION, 1]}  # 1: fastest
_WRITERS = 2  # threads that encode and write; raised, more frames a second are stored and more cores are used
_PENDING = 16  # frames that may wait to be written before frames are dropped; raised, short delays of the disk cost none, but memory


@dataclass(frozen=True)
class RecordingSummary:
    """What was recorded."""

    folder: Path
    frames: int
    dropped: int  # frames that came faster than they could be written
    seconds: float


def record(
    stream: LiveStream,
    folder: Path,
    *,
    seconds: float | None = None,
    png: bool = False,
    report: Callable[[int, int], None] = lambda stored, dropped: None,
) -> RecordingSummary:
    """Records as many frames as can be written, until the stream ends, for `seconds` [s], or until Ctrl-C.

    png: store colour without loss, in larger files. report: called with the numbers of stored and dropped frames after each frame.
    Raises ResultError if the folder holds a recording already or a frame cannot be written; frames stored before remain readable.
    """
    _prepare(folder, stream)
    start = time.monotonic()
    with stop_on_interrupt() as stop, FrameWriter(folder, ".png" if png else ".jpg") as writer:
        for _, frame in stream:
            if isinstance(frame, Frame):
                writer.put(frame)
            else:
                log.warning("%s; the frame is left out", frame)
            report(writer.stored, stream.dropped)
            if stop.is_set() or (seconds is not None and time.monotonic() - start >= seconds):
                break
    report(writer.stored, stream.dropped)
    return RecordingSummary(folder, writer.stored, stream.dropped, time.monotonic() - start)


def _prepare(folder: Path, stream: LiveStream) -> None:
    """Makes the folders and writes the camera's files: intrinsics.txt, and cam_params.json if something is known about its times."""
    if found := [name for name in (*COLOUR_FOLDERS, _DEPTH, STAMPS, _INTRINSICS, CAM_PARAMS) if (folder / name).exists()]:
        raise ResultError(f"{folder}: holds a recording already ({found[0]}); choose another folder with --out")
    atomic_files.prepare(folder)
    for name in (_COLOUR, _DEPTH):
        (folder / name).mkdir()
    with atomic_files.replacing(folder / _INTRINSICS) as part:
        np.savetxt(part, stream.camera.matrix().numpy(), fmt="%.10g")
    known = {name: value for name in TIMES if (value := getattr(stream.timing, name)) is not None}
    if known:
        atomic_files.write_json(folder / CAM_PARAMS, {"camera": known})


class FrameWriter:
    """Stores frames in background threads. A frame counts as stored once timestamps.txt has its line; the reader ignores it before.

    Raises ResultError if a frame cannot be written, from `put` or when the context ends; frames stored before remain.
    """

    def __init__(self, folder: Path, colour_suffix: str) -> None:
        self.stored = 0
        self._folder, self._suffix = folder, colour_suffix
        self._pool = ThreadPoolExecutor(_WRITERS, thread_name_prefix="writer")
        self._pending: deque[Future[None]] = deque()
        self._lock = threading.Lock()
        self._full = False

    def __enter__(self) -> "FrameWriter":
        self._stamps = (self._folder / STAMPS).open("wb", buffering=0)
        return self

    def put(self, frame: Frame) -> None:
        """Hands a frame to the threads; waits while too many are pending."""
        self._pending.append(self._pool.submit(self._store, frame))
        while self._pending and (self._pending[0].done() or len(self._pending) > _PENDING):
            self._check_written(self._pending.popleft())

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        self._pool.shutdown(wait=True)
        self._stamps.close()
        while self._pending and kind is None:
            self._check_written(self._pending.popleft())

    def _check_written(self, future: Future[None]) -> None:
        try:
            future.result()
        except OSError as error:
            kept = f"the {self.stored} frames stored before can be read"
            raise ResultError(f"{self._folder}: a frame cannot be written ({error.strerror}); {kept}") from error

    def _store(self, frame: Frame) -> None:
        """Writes colour, depth, and last the line in timestamps.txt, all under the frame's index."""
        name = f"{frame.index:06d}"
        try:
            _write(self._folder / _COLOUR / f"{name}{self._suffix}", bgr(frame))
            _write(self._folder / _DEPTH / f"{name}.png", millimetres(frame))
            with self._lock:
                if self._full:
                    return
                if not self.stored:
                    self._write_line(HEADER)
                self._write_line(f"{name} {frame.timestamp:.6f} {frame.timestamp + frame.depth_lag:.6f}")
                self.stored += 1
        except OSError:
            self._full = True  # no line may follow an incomplete one
            raise

    def _write_line(self, text: str) -> None:
        line = f"{text}\n".encode()
        if self._stamps.write(line) != len(line):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _write(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    _, data = cv2.imencode(path.suffix, image, _ENCODING[path.suffix])
    with atomic_files.replacing(path) as part:
        part.write_bytes(data.tobytes())


def bgr(frame: Frame) -> NDArray[np.uint8]:
    """Colour (H, W, 3) uint8 for an image file; colour that came from 8 bits is restored exactly."""
    return np.asarray(cv2.cvtColor(np.rint(frame.colour * 255).astype(np.uint8), cv2.COLOR_RGB2BGR), np.uint8)


def millimetres(frame: Frame) -> NDArray[np.uint16]:
    """Depth (H, W) [mm], 0 where there is no reading or it exceeds 16 bits."""
    units = np.rint(frame.depth * _UNITS)
    return np.where(units < SATURATED, units, 0).astype(np.uint16)
