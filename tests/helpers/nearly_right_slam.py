"""A Slam that nearly knows the answer, for whole runs: also one that diverges, and one that is interrupted."""

import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from helpers.box_room import BOX_FRAMES, box_poses
from helpers.stand_in_slam import StandInSlam
from idfslam.config import FAST, Config
from idfslam.errors import DivergedError
from idfslam.frame import Frame, FrameResult, Status, StoredKeyframe
from idfslam.runs.run_config import RecordingSource
from idfslam.runs.runner import RunResult, run
from idfslam.runs.source import open_source


class NearlyRightSlam(StandInSlam):
    """Answers with the true poses, 1 cm off in the second half; every fifth frame is a keyframe."""

    edges = 2
    pairs = ([0, 10],)

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.timings = {"track": [2.0] * BOX_FRAMES, "map": [70.0]}
        self.finished = False

    def process(self, frame: Frame) -> FrameResult:
        self.frames.append(frame)
        pose, status = self.trajectory()[-1], self.statuses()[-1]
        keyframe = status is Status.OK and frame.index % 5 == 0
        if keyframe:
            self.keyframes.append(StoredKeyframe(frame.index, pose, frozenset(), submap=0, camera=frame.camera))
        return FrameResult(frame.index, frame.timestamp, pose, status, keyframe, {"sdf": 0.1} if keyframe else {})

    def finish(self) -> None:
        self.finished = True

    def trajectory(self) -> NDArray[np.float64]:
        poses = box_poses()[: len(self.frames)]
        poses[BOX_FRAMES // 2 :, 1, 3] += 0.01
        return poses

    def statuses(self) -> list[Status]:
        return [Status.OK if frame.depth.any() else Status.LOST for frame in self.frames]

    def mesh(self, resolution: float) -> trimesh.Trimesh:
        assert self.finished
        return super().mesh(resolution)


class DivergingSlam(NearlyRightSlam):
    """A loss is not finite at frame 6."""

    def process(self, frame: Frame) -> FrameResult:
        if frame.index == 6:
            raise DivergedError("the map's loss at keyframe 6 is nan")
        return super().process(frame)


class InterruptedSlam(NearlyRightSlam):
    """Ctrl-C comes while frame 3 is worked on."""

    def process(self, frame: Frame) -> FrameResult:
        if frame.index == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return super().process(frame)


def run_known(recording: Path, folder: Path, slam: Any = NearlyRightSlam, *, overwrite: bool = False) -> RunResult:
    source = RecordingSource(str(recording))
    return run(open_source(source), FAST, folder, source=source, make_slam=slam, overwrite=overwrite)
