"""A Slam that knows the answer, for what looks at one: the box room's true poses, every fifth frame a keyframe, a red box as the mesh."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from helpers.box_room import box_poses
from helpers.grey_archive import grey_archive
from idfslam.config import Config
from idfslam.frame import Frame, FrameResult, Status, StoredKeyframe
from idfslam.views.image_archive import ImageArchive

LOST, DEGENERATE = 6, 9  # frames
RED = (220, 30, 30, 255)


class KnownSlam:
    def __init__(self, config: Config) -> None:
        self.keyframes: list[StoredKeyframe] = []
        self.closed: list[SimpleNamespace] = []
        self.timings: dict[str, list[float]] = {"track": [], "map": []}
        self.processed = 0

    def process(self, frame: Frame) -> FrameResult:
        i, self.processed = self.processed, self.processed + 1
        keyframe, keyframes = i % 5 == 0, self.keyframes
        self.timings["track"] += [2.0, 3.0]  # called twice a frame
        if keyframe:
            self.timings["map"].append(70.0)
            covisible = frozenset({len(keyframes) - 1} if keyframes else ())
            keyframes.append(StoredKeyframe(i, self.trajectory()[-1], covisible, submap=0, camera=frame.camera))
        losses = {"sdf": 0.5 / (i + 1)} if keyframe else {}
        return FrameResult(i, frame.timestamp, self.trajectory()[-1], self.statuses()[-1], keyframe, losses)

    def finish(self) -> None: ...

    def stored_keyframes(self) -> list[StoredKeyframe]:
        return self.keyframes

    def loops(self) -> list[SimpleNamespace]:
        return self.closed

    def trajectory(self) -> NDArray[np.float64]:
        poses = box_poses()
        return np.linalg.inv(poses[0]) @ poses[: self.processed]

    def live_trajectory(self) -> NDArray[np.float64]:
        return self.trajectory()

    def figures(self) -> dict[str, Any]:
        return {"edges": 2, "loops": [], "loops_refused": 0, "relocalisations": 0, "finetuning_rollbacks": 0}

    def statuses(self) -> list[Status]:
        odd = {LOST: Status.LOST, DEGENERATE: Status.DEGENERATE}
        return [odd.get(i, Status.OK) for i in range(self.processed)]

    def mesh(self, resolution: float) -> trimesh.Trimesh:
        box = trimesh.creation.box((1.6, 1.6, 1.6), transform=trimesh.transformations.translation_matrix((0, 0, 2)))
        box.visual.vertex_colors = np.tile(np.array(RED, np.uint8), (len(box.vertices), 1))
        return box

    def archive_in(self, folder: Path) -> None: ...

    def archive(self) -> ImageArchive:
        return grey_archive()

    def save_map(self, path: Path) -> None:
        path.write_bytes(b"map")
