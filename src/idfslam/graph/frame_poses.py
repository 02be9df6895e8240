"""The pose of every frame, relative to a stored keyframe. A frame moves with its host keyframe."""

import itertools
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.storage.state import State, Stateful

_AROUND = 0.3  # [s] standard deviation of the weights of keyframes around a frame. More: frames follow more keyframes. Chosen by hand
_NOTHING = 1e-3  # [1] weight of a keyframe, beside that of the nearest, below which it is left out. More: faster, less smooth


@dataclass(frozen=True)
class _FramePose:
    """The pose of a frame in its host keyframe."""

    host: int
    T_kc: Tensor  # (4, 4) float64
    status: Status
    timestamp: float


class FramePoses(Stateful):
    """The poses of all processed frames, in order."""

    def __init__(self, graph: KeyframeGraph) -> None:
        self.graph = graph
        self._frames: list[_FramePose] = []

    def __len__(self) -> int:
        return len(self._frames)

    def state(self) -> State:
        """The frames' poses, column by column."""
        frames = self._frames
        return {
            "host": [frame.host for frame in frames],
            "T_kc": torch.stack([frame.T_kc for frame in frames]) if frames else torch.zeros(0, 4, 4, dtype=torch.float64),
            "status": [frame.status.value for frame in frames],
            "timestamp": [frame.timestamp for frame in frames],
        }

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        rows = zip(state["host"], state["T_kc"], state["status"], state["timestamp"])
        self._frames = [_FramePose(host, T_kc.clone(), Status(status), timestamp) for host, T_kc, status, timestamp in rows]

    def append(self, timestamp: float, T_wc: Tensor, status: Status) -> None:
        """Adds a tracked frame, relative to the host of the last keyframe."""
        host, T_kc = self.graph.relative_to_host(T_wc)
        self._frames.append(_FramePose(host, T_kc, status, timestamp))

    def attach_last(self, keyframe: Keyframe) -> None:
        """Attaches the last frame, which has become a keyframe, to that keyframe's host."""
        host, T_kc = self.graph.relative_to_host(keyframe.T_wk)
        self._frames[-1] = replace(self._frames[-1], host=host, T_kc=T_kc)

    @property
    def last_status(self) -> Status:
        """The status of the last frame."""
        return self._frames[-1].status

    def T_wc(self, i: int) -> Tensor:
        """The pose (4, 4) float64 of the i-th frame."""
        frame = self._frames[i]
        return self.graph.keyframes[frame.host].T_wk @ frame.T_kc if self.graph.keyframes else frame.T_kc

    def around(self, keyframe: Keyframe, reach: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Stamps (M,) [s] and poses (M, 4, 4) of the frame of a keyframe, and up to `reach` before and after it.

        They are tracked without a gap, and of one submap. Empty if the frame is not tracked itself, or is of another run.
        """
        at = bisect_left(self._frames, keyframe.timestamp, key=lambda frame: frame.timestamp)
        if at == len(self) or not self._frames[at].status.trusted or not self._is_of(at, keyframe):
            return np.zeros(0), np.zeros((0, 4, 4))

        def belongs(i: int) -> bool:
            return self._frames[i].status.trusted and self.submap(i) == self.submap(at)

        before = list(itertools.takewhile(belongs, range(at - 1, max(at - reach, 0) - 1, -1)))
        after = list(itertools.takewhile(belongs, range(at + 1, min(at + reach + 1, len(self)))))
        chosen = [*reversed(before), at, *after]
        return np.array([self._frames[i].timestamp for i in chosen]), np.stack([self.T_wc(i).numpy() for i in chosen])

    def _is_of(self, i: int, keyframe: Keyframe) -> bool:
        """Whether the i-th frame is a keyframe's; those of a map from another run may have the same stamps."""
        return self._frames[i].timestamp == keyframe.timestamp and bool(torch.allclose(self.T_wc(i), keyframe.T_wk, atol=1e-9))

    def submap(self, i: int) -> int:
        """The submap of the i-th frame."""
        return self.graph.keyframes[self._frames[i].host].submap if self.graph.keyframes else 0

    def follow_around(self, before: Sequence[Tensor]) -> None:
        """Moves each frame by what the keyframes around it have moved, on average, from their poses `before` (K) of (4, 4).

        Without it a frame moves as its host keyframe. Where a keyframe's own images were bent, that is no error of its frames.
        """
        keyframes = self.graph.keyframes
        stamps = np.array([keyframe.timestamp for keyframe in keyframes])
        moves = torch.stack([keyframe.T_wk for keyframe in keyframes]) @ se3.inverse(torch.stack(list(before)))
        submaps = np.array([keyframe.submap for keyframe in keyframes])
        for i, frame in enumerate(self._frames):
            if frame.timestamp == stamps[frame.host]:
                continue  # the keyframe itself
            apart = np.where(submaps == submaps[frame.host], np.abs(stamps - frame.timestamp) / _AROUND, np.inf)
            weight = np.exp((apart.min() ** 2 - apart**2) / 2)
            near = np.flatnonzero(weight > _NOTHING)
            T_before = before[frame.host] @ frame.T_kc
            change = se3.log(se3.inverse(T_before) @ moves[near] @ T_before)
            mean = torch.from_numpy(weight[near] / weight[near].sum()) @ change
            T_kc = se3.inverse(keyframes[frame.host].T_wk) @ T_before @ se3.exp(mean)
            self._frames[i] = replace(frame, T_kc=se3.orthonormal(T_kc))

    def trajectory(self) -> NDArray[np.float64]:
        """(N, 4, 4) poses of all frames. A frame outside the first submap has the pose of the last frame before it inside."""
        poses: list[NDArray[np.float64]] = []
        for i in range(len(self)):
            poses.append(self.T_wc(i).numpy() if self.submap(i) == 0 else poses[-1] if poses else np.eye(4))
        return np.stack(poses) if poses else np.zeros((0, 4, 4))

    def statuses(self) -> list[Status]:
        """The status of each frame. Frames outside the first submap count as lost."""
        return [frame.status if self.submap(i) == 0 else Status.LOST for i, frame in enumerate(self._frames)]

    def interpolate_gaps(self) -> int:
        """Interpolates the poses of lost frames between two tracked frames of one submap; returns how many there were."""
        posed = [i for i, frame in enumerate(self._frames) if frame.status is not Status.LOST]
        return sum(self._interpolate(i, j) for i, j in itertools.pairwise(posed) if j > i + 1 and self.submap(i) == self.submap(j))

    def _interpolate(self, start: int, end: int) -> int:
        """Interpolates the frames between frames `start` and `end`, at constant velocity."""
        T_before, T_after = self.T_wc(start), self.T_wc(end)
        t_before, span = self._frames[start].timestamp, self._frames[end].timestamp - self._frames[start].timestamp
        step = se3.log(se3.inverse(T_before) @ T_after)
        for i in range(start + 1, end):
            frame = self._frames[i]
            share = (frame.timestamp - t_before) / span if span > 0 else 0.5
            T_kc = se3.inverse(self.graph.keyframes[frame.host].T_wk) @ T_before @ se3.exp(share * step)
            self._frames[i] = replace(frame, T_kc=T_kc, status=Status.INTERPOLATED)
        return end - start - 1

    def undo_interpolation_before(self, keyframe: int) -> None:
        """Marks the interpolated frames just before the first frame of a keyframe as lost again: that keyframe's pose was wrong."""
        gap = next(i for i, frame in enumerate(self._frames) if frame.host >= keyframe) - 1
        while gap >= 0 and self._frames[gap].status is Status.INTERPOLATED:
            self._frames[gap] = replace(self._frames[gap], status=Status.LOST)
            gap -= 1
