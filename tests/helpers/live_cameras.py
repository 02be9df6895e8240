"""Cameras for the tests: one fed by hand, one that is pulled out, and a Slam that knows where each moment was seen from."""

import queue
import time

import numpy as np
from numpy.typing import NDArray

from helpers.box_room import BOX_FRAMES, box_poses
from helpers.stand_in_slam import StandInSlam
from idfslam.datasets import Dataset
from idfslam.errors import CameraError
from idfslam.frame import Frame, FrameResult, Status, StoredKeyframe
from idfslam.geometry.camera import Camera
from idfslam.live import Capture
from idfslam.live.playback import Playback

CAMERA = Camera(4, 3, 5.0, 5.0, 1.5, 1.0)


def capture(stamp: float, depth: float = 1.0) -> Capture:
    """Images of one moment; red is its hundredth."""

    def retrieve(index: int) -> Frame:
        colour = np.zeros((3, 4, 3), np.float32)
        colour[..., 0] = stamp / 100
        return Frame(index, stamp, colour, np.full((3, 4), depth, np.float32), CAMERA)

    return Capture(stamp, retrieve)


class HandFed:
    """Gives what the test hands it; an error is raised, None is the end."""

    name, camera = "hand-fed", CAMERA

    def __init__(self) -> None:
        self._given: queue.Queue[Capture | Exception | None] = queue.Queue()
        self._taken = False
        self.closed = False

    def give(self, *captures: Capture | Exception | None) -> None:
        """Returns once the last one is taken and, unless it ends the camera, the next one is asked for."""
        for one in captures:
            self._given.put(one)
        self._given.join()

    def grab(self) -> Capture | None:
        if self._taken:
            self._given.task_done()
        one = self._given.get()
        self._taken = True
        if not isinstance(one, Capture):
            self._given.task_done()
        if isinstance(one, Exception):
            raise one
        return one

    def close(self) -> None:
        self.closed = True


class PulledOut(Playback):
    """A recording whose camera is gone after some frames."""

    def __init__(self, recording: Dataset, *, after: int) -> None:
        super().__init__(recording, speed=10)
        self._left = after

    def grab(self) -> Capture | None:
        if self._left == 0:
            raise CameraError("box: the cable is out")
        self._left -= 1
        time.sleep(0.03)  # that none is overtaken
        return super().grab()


class SeeingSlam(StandInSlam):
    """Answers each frame with the box room's pose at its stamp."""

    seconds = 0.0  # for a frame

    def process(self, frame: Frame) -> FrameResult:
        time.sleep(self.seconds)
        self.frames.append(frame)
        pose = self.trajectory()[-1]
        if len(self.frames) == 1:
            self.keyframes.append(StoredKeyframe(frame.index, pose, frozenset(), submap=0, camera=frame.camera))
        return FrameResult(frame.index, frame.timestamp, pose, Status.OK, len(self.frames) == 1, {})

    def trajectory(self) -> NDArray[np.float64]:
        return box_poses()[[round(frame.timestamp * 30) % BOX_FRAMES for frame in self.frames]]


class SlowSlam(SeeingSlam):
    """Takes as long as three frames of the recording."""

    seconds = 0.1
