"""A Slam that knows the answer, for what looks at one: the box room's true poses, every fifth frame a keyframe, a red box as the mesh."""

from types import SimpleNamespace

import numpy as np
import trimesh
from numpy.typing import NDArray

from helpers.box_room import box_poses
from helpers.stand_in_slam import StandInSlam
from idfslam.config import Config
from idfslam.frame import Frame, FrameResult, Status, StoredKeyframe

LOST, DEGENERATE = 6, 9  # frames
RED = (220, 30, 30, 255)


class KnownSlam(StandInSlam):
    edges = 2

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self.closed: list[SimpleNamespace] = []
        self.timings = {"track": [], "map": []}

    def process(self, frame: Frame) -> FrameResult:
        i, keyframes = len(self.frames), self.keyframes
        self.frames.append(frame)
        keyframe = i % 5 == 0
        self.timings["track"] += [2.0, 3.0]  # called twice a frame
        if keyframe:
            self.timings["map"].append(70.0)
            covisible = frozenset({len(keyframes) - 1} if keyframes else ())
            keyframes.append(StoredKeyframe(i, self.trajectory()[-1], covisible, submap=0, camera=frame.camera))
        losses = {"sdf": 0.5 / (i + 1)} if keyframe else {}
        return FrameResult(i, frame.timestamp, self.trajectory()[-1], self.statuses()[-1], keyframe, losses)

    def loops(self) -> list[SimpleNamespace]:
        return self.closed

    def trajectory(self) -> NDArray[np.float64]:
        poses = box_poses()
        return np.linalg.inv(poses[0]) @ poses[: len(self.frames)]

    def statuses(self) -> list[Status]:
        odd = {LOST: Status.LOST, DEGENERATE: Status.DEGENERATE}
        return [odd.get(i, Status.OK) for i in range(len(self.frames))]

    def mesh(self, resolution: float) -> trimesh.Trimesh:
        box = trimesh.creation.box((1.6, 1.6, 1.6), transform=trimesh.transformations.translation_matrix((0, 0, 2)))
        box.visual.vertex_colors = np.tile(np.array(RED, np.uint8), (len(box.vertices), 1))
        return box
