"""A recording that plays in real time like a live camera: for tests, demonstrations and use without a camera."""

from dataclasses import replace
from functools import partial
from time import perf_counter, sleep

from idfslam.datasets import Dataset
from idfslam.datasets.recording import timing
from idfslam.frame import Frame
from idfslam.live.depth_camera import Capture


class Playback:
    """Frame i comes (stamp i - stamp 0) / `speed` seconds after the first and keeps its stamp and true pose."""

    def __init__(self, recording: Dataset, *, speed: float = 1.0) -> None:
        self.name, self.camera, self.timing = recording.name, recording.camera, timing(recording)
        self._recording, self._speed = recording, speed
        self._next, self._start = 0, 0.0

    def grab(self) -> Capture | None:
        i, stamps, truth = self._next, self._recording.timestamps, self._recording.ground_truth
        if i == len(self._recording):
            return None
        if i == 0:
            self._start = perf_counter()
        sleep(max(0.0, self._start + (stamps[i] - stamps[0]) / self._speed - perf_counter()))
        self._next += 1
        return Capture(float(stamps[i]), partial(self._retrieve, i), None if truth is None else truth[i])

    def close(self) -> None:
        """Does nothing: no device is open."""

    def _retrieve(self, i: int, index: int) -> Frame:
        return replace(self._recording[i], index=index)
