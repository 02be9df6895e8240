"""A recent frame as one more reference of the alignment, where the keyframes show little of the present view.

While the camera turns into new ground, its images may be too blurred to be mapped, and no keyframe is made. Then the last keyframe sees
less and less of the view. A frame of a moment ago sees nearly all of it, and is as blurred. So the pose follows the image from frame to
frame, and drifts little until the next keyframe.
"""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.alignment.aligner import MapAligner
from idfslam.alignment.landmarks import Landmarks
from idfslam.compute.backend import pick
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.slam.tracked import Tracked
from idfslam.storage.state import State, Stateful

Array = NDArray[np.float64]

# Both were chosen by hand on generated hand-held recordings and on fr1/rpy.
# [1] Share of the keyframes' landmarks within the view from which these are enough. More: a recent frame is used more often, and costs
# time.
_ENOUGH = 0.7
# [1] Share of the recent frame's landmarks in view below which a newer frame takes its place. More: it is replaced more often, and each
# time its own error stays in the poses.
_SHARED = 0.95


class RecentFrame(Stateful):
    """Keeps the landmarks of a recent frame while they are needed."""

    def __init__(self, aligner: MapAligner, frames: FramePoses) -> None:
        self.aligner, self.frames = aligner, frames
        self._landmarks: Landmarks | None = None  # None: the keyframes are enough
        self._index = 0  # of the recent frame

    def state(self) -> State:
        """The landmarks and the frame's index."""
        marks = self._landmarks
        kept = None if marks is None else {"points": marks.points, "luminance": marks.luminance, "slopes": marks.slopes}
        return {"landmarks": kept, "index": self._index}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        kept = state["landmarks"]
        self._landmarks, self._index = None if kept is None else Landmarks(**kept), state["index"]

    def reference(self) -> tuple[Landmarks, Tensor] | None:
        """The landmarks of the recent frame, and its pose (4, 4); None where the keyframes are enough."""
        return None if self._landmarks is None else (self._landmarks, self.frames.T_wc(self._index))

    def accept(self, view: Keyframe, tracked: Tracked, references: Sequence[Keyframe]) -> None:
        """Takes over the last frame, if one is needed and the one before shares too little with it. references: it was aligned to these."""
        if tracked.is_lost or tracked.evidence.in_view >= _ENOUGH or self._within(view, tracked.T_wc, references) >= _ENOUGH:
            self._landmarks = None
        elif view.has_depth and not (view.colour_is_older or view.is_clipped) and self._shared(view, tracked.T_wc) < _SHARED:
            self._landmarks, self._index = self.aligner.appearances.landmarks(view), view.index

    def _within(self, view: Keyframe, T_wc: Tensor, references: Sequence[Keyframe]) -> float:
        """The share of the keyframes' landmarks that lie within a view at this pose (4, 4). Somebody may stand before them."""
        marks = [(self.aligner.appearances.landmarks(reference).points, reference.T_wk) for reference in references]
        inside = sum(_inside(view, T_wc, points, T_wk) for points, T_wk in marks)
        return inside / max(sum(len(points) for points, _ in marks), 1)

    def _shared(self, view: Keyframe, T_wc: Tensor) -> float:
        """The same of the recent frame's landmarks; 0 without any."""
        if (reference := self.reference()) is None:
            return 0.0
        (marks, T_wk), count = reference, len(reference[0].points)
        return _inside(view, T_wc, marks.points, T_wk) / max(count, 1)


def _inside(view: Keyframe, T_wc: Tensor, points: Tensor, T_wk: Tensor) -> int:
    """How many points (N, 3) along the axes of a camera at T_wk (4, 4) lie within a view at T_wc."""
    of_world = view.camera.frustum() @ T_wc[:3, :3].numpy().T
    normals, offsets = of_world @ T_wk[:3, :3].numpy(), of_world @ (T_wk - T_wc)[:3, 3].numpy()
    return pick(points, compiled=compiled_within, plain=plain_within)(points, normals, offsets)


def plain_within(points: Tensor, normals: Array, offsets: Array) -> int:
    """How many points (N, 3) lie before all planes with normals (K, 3) and offsets (K,): in torch, on any device."""
    distances = points @ torch.from_numpy(normals.T).to(points) + torch.from_numpy(offsets).to(points)
    return int((distances > 0).all(-1).sum())


def compiled_within(points: Tensor, normals: Array, offsets: Array) -> int:
    """`plain_within` by Numba, on the CPU."""
    from idfslam.alignment.kernels.numba_landmarks import count_within

    return int(count_within(points.numpy(), normals.astype(np.float32), offsets.astype(np.float32)))
