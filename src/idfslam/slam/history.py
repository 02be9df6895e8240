"""The poses reported while the camera moved, before later frames, loops and the polish improved them."""

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.frame import Frame, FrameResult, Status
from idfslam.graph.frame_poses import FramePoses
from idfslam.slam.tracked import Tracked
from idfslam.storage.state import State, Stateful

Mask = NDArray[np.bool_]


class History(Stateful):
    """Reports each frame, and keeps the reported poses."""

    def __init__(self, frames: FramePoses) -> None:
        self.frames = frames
        self._reported: list[NDArray[np.float64]] = []

    def state(self) -> State:
        """The poses."""
        return {"reported": torch.from_numpy(self.poses())}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._reported = list(state["reported"].numpy())

    def poses(self) -> NDArray[np.float64]:
        """(N, 4, 4) the reported camera-to-world poses."""
        return np.stack(self._reported) if self._reported else np.zeros((0, 4, 4))

    def report(
        self, frame: Frame, tracked: Tracked, losses: dict[str, float], *, keyframe: bool, moving: Mask | None = None
    ) -> FrameResult:
        """The result for the frame added last. A frame outside the main submap has no known pose in the world: it counts as lost."""
        if self.frames.submap(-1) == self.frames.graph.main_submap:
            self._reported.append(self.frames.T_wc(-1).numpy())
            status, covariance = tracked.status, None if tracked.covariance is None else tracked.covariance.numpy().copy()
        else:
            self._reported.append(self._reported[-1] if self._reported else np.eye(4))
            status, covariance = Status.LOST, None
        return FrameResult(frame.index, frame.timestamp, self._reported[-1], status, keyframe, losses, covariance, moving)
