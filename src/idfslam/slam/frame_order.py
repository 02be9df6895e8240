"""Which frame may come next: frames of a run are numbered without gaps and are of one camera."""

import logging
import math
from dataclasses import asdict

from idfslam.errors import FrameError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.storage.state import State, Stateful

log = logging.getLogger(__name__)


class FrameOrder(Stateful):
    """What the frames so far say about the next one."""

    def __init__(self) -> None:
        self._count = 0
        self._camera: Camera | None = None  # None: no frame yet
        self._stamp, self._in_order = -math.inf, True  # [s] of the last frame; whether all stamps are later than those before

    def check(self, frame: Frame) -> None:
        """Raises FrameError unless the frame is the next one of the same camera. The first stamp that is not later is logged."""
        if frame.index != self._count:
            raise FrameError(f"frame has index {frame.index}, expected {self._count}: number the frames 0, 1, 2 ... without gaps")
        if self._camera not in (None, frame.camera):
            raise FrameError(f"frame {frame.index} is of {frame.camera}, expected {self._camera} as before: use one camera for a run")
        if self._in_order and frame.timestamp <= self._stamp:
            self._in_order = False
            log.warning("frame %d has the time stamp %.6f s, expected more than %.6f s", frame.index, frame.timestamp, self._stamp)
        self._count, self._camera, self._stamp = self._count + 1, frame.camera, frame.timestamp

    def state(self) -> State:
        """The number of frames, their camera, and the last stamp."""
        camera = None if self._camera is None else asdict(self._camera)
        return {"count": self._count, "camera": camera, "stamp": self._stamp if self._count else None, "in_order": self._in_order}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._count, self._in_order = state["count"], state["in_order"]
        self._camera = None if state["camera"] is None else Camera(**state["camera"])
        self._stamp = state["stamp"] if self._count else -math.inf
