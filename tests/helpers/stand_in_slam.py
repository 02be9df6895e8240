"""What a run calls of `Slam`, without any SLAM. A subclass says where the camera is."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from helpers.grey_archive import grey_archive
from idfslam.config import Config
from idfslam.frame import Frame, Status, StoredKeyframe
from idfslam.views.image_archive import ImageArchive


class StandInSlam:
    edges = 0
    pairs: tuple[list[int], ...] = ()  # of frames that loops connect

    def __init__(self, config: Config) -> None:
        self.frames: list[Frame] = []
        self.keyframes: list[StoredKeyframe] = []
        self.timings: dict[str, list[float]] = {}

    def finish(self) -> None: ...

    def stored_keyframes(self) -> list[StoredKeyframe]:
        return self.keyframes

    def trajectory(self) -> NDArray[np.float64]:
        raise NotImplementedError

    def live_trajectory(self) -> NDArray[np.float64]:
        return self.trajectory()

    def figures(self) -> dict[str, Any]:
        return {"edges": self.edges, "loops": [*self.pairs], "loops_refused": 0, "relocalisations": 0, "finetuning_rollbacks": 0}

    def statuses(self) -> list[Status]:
        return [Status.OK] * len(self.frames)

    def mesh(self, resolution: float) -> trimesh.Trimesh:
        return trimesh.creation.box((3.0, 2.2, 3.6))

    def swap_to(self, folder: Path) -> None: ...

    def archive(self) -> ImageArchive:
        return grey_archive()

    def save_map(self, path: Path) -> None:
        path.write_bytes(b"map")
