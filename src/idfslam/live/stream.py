"""A live camera as a source of frames without lag: a thread grabs images and keeps only the newest ones."""

import itertools
import logging
import threading
from collections.abc import Iterator
from concurrent.futures import Future

import numpy as np
from numpy.typing import NDArray

from idfslam.errors import CameraError, FrameError
from idfslam.frame import Frame
from idfslam.geometry.sensor_timing import UNKNOWN, SensorTiming
from idfslam.live.depth_camera import Capture, DepthCamera

log = logging.getLogger(__name__)

TIMEOUT = 5.0  # [s] without images after which a camera counts as disconnected; raised, pauses are tolerated. Chosen by hand


class LiveStream:
    """Iterates once over (index, Frame), or (index, FrameError) for a bad frame, of a camera; frames are numbered from 0.

    Images that are replaced by newer ones before the consumer requests them are dropped and counted. A slow consumer is therefore at most
    one frame behind, and memory holds at most two frames. The iteration ends with the camera's images, after `frames` frames, when the
    consumer stops, or when the camera is disconnected. In the last case `failure` holds the error; it is raised if there was no frame.
    """

    def __init__(self, device: DepthCamera, *, frames: int | None = None, timeout: float = TIMEOUT) -> None:
        self.name, self.camera, self.timing = device.name, device.camera, timing_of(device)
        self.dropped = 0
        self.failure: CameraError | None = None
        self._device, self._frames, self._timeout = device, frames, timeout
        self._stamps: list[float] = []
        self._truth: list[NDArray[np.float64] | None] = []
        self._waiting: Capture | None = None
        self._changed = threading.Condition()
        self._stop = threading.Event()
        self._end: Future[None] = Future()

    @property
    def timestamps(self) -> NDArray[np.float64]:
        """(N,) [s] stamps of the frames so far."""
        return np.array(self._stamps, np.float64)

    @property
    def ground_truth(self) -> NDArray[np.float64] | None:
        """(N, 4, 4) true poses of the frames so far, NaN where a frame has none; None if no frame has one."""
        if all(T_gt is None for T_gt in self._truth):
            return None
        return np.stack([np.full((4, 4), np.nan) if T_gt is None else T_gt for T_gt in self._truth])

    def __iter__(self) -> Iterator[tuple[int, Frame | FrameError]]:
        # A daemon, since a driver that hangs must not keep the program from ending
        grabbing = threading.Thread(target=self._grab, name="camera", daemon=True)
        grabbing.start()
        try:
            for i in itertools.count() if self._frames is None else range(self._frames):
                capture = self._newest()
                if capture is None:
                    break
                self._stamps.append(capture.timestamp)
                self._truth.append(capture.T_gt)
                yield i, _retrieve(capture, i)
        finally:
            self._stop.set()
            grabbing.join(self._timeout)
        if self.failure is not None:
            if not self._stamps:
                raise self.failure
            log.warning("%s; the camera counts as disconnected after %d frames", self.failure, len(self._stamps))

    def _newest(self) -> Capture | None:
        """The newest images that were not returned before; waits if there are none. None at the end."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._waiting is not None or self._end.done(), self._timeout):
                self.failure = CameraError(f"{self.name}: no images for {self._timeout:.3g} s: is it still plugged in?")
            capture, self._waiting = self._waiting, None
        if capture is None and self._end.done():
            error = self._end.exception()
            if error is not None and not isinstance(error, CameraError):
                raise error
            self.failure = error
        return capture

    def _grab(self) -> None:
        """Runs in the thread: replaces the waiting images by each new ones until the camera or the consumer ends."""
        last = -np.inf
        error: BaseException | None = None
        try:
            while not self._stop.is_set() and (capture := self._device.grab()) is not None:
                if capture.timestamp <= last:
                    continue  # the same images as before
                last = capture.timestamp
                with self._changed:
                    self.dropped += self._waiting is not None
                    self._waiting = capture
                    self._changed.notify()
            self._device.close()
        except BaseException as caught:  # raised again in the consumer's thread
            error = caught
        with self._changed:
            if error is None:
                self._end.set_result(None)
            else:
                self._end.set_exception(error)
            self._changed.notify()


def timing_of(device: DepthCamera) -> SensorTiming:
    """What a camera says about its sensor's times: its attribute `timing`; without it nothing is known."""
    found: SensorTiming = getattr(device, "timing", UNKNOWN)
    return found


def _retrieve(capture: Capture, index: int) -> Frame | FrameError:
    try:
        return capture.retrieve(index)
    except FrameError as error:
        return error
