"""The pose of every frame, relative to a stored keyframe. A frame moves with its host keyframe."""

import itertools
from bisect import bisect_left, bisect_right
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
from idfslam.graph.shared_correction import shared, usual_unevenness
from idfslam.storage.state import State, Stateful

_LATEST = 10  # frames that `correct_latest` moves at most. More: slower, and frames of which nothing is left to correct. Chosen by hand


@dataclass(frozen=True)
class _FramePose:
    """The pose of a frame in its host keyframe."""

    host: int
    T_kc: Tensor  # (4, 4) float64
    status: Status
    timestamp: float
    tracked: tuple[int, Tensor] | None = None  # host and pose before it was refined, as keyframes are; None: it was not


class FramePoses(Stateful):
    """The poses of all processed frames, in order."""

    def __init__(self, graph: KeyframeGraph) -> None:
        self.graph = graph
        self._frames: list[_FramePose] = []

    def __len__(self) -> int:
        return len(self._frames)

    def state(self) -> State:
        """The frames' poses, column by column, and those of refined frames before that."""
        frames, refined = self._frames, self._refined()
        return {
            "host": [frame.host for frame in frames],
            "T_kc": _stacked([frame.T_kc for frame in frames]),
            "status": [frame.status.value for frame in frames],
            "timestamp": [frame.timestamp for frame in frames],
            "refined": refined,
            "tracked_host": [host for i in refined for host, _ in [self._tracked(i)]],
            "tracked_T_kc": _stacked([T_kc for i in refined for _, T_kc in [self._tracked(i)]]),
        }

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        rows = zip(state["host"], state["T_kc"], state["status"], state["timestamp"])
        self._frames = [_FramePose(host, T_kc.clone(), Status(status), timestamp) for host, T_kc, status, timestamp in rows]
        for i, host, T_kc in zip(state["refined"], state["tracked_host"], state["tracked_T_kc"]):
            self._frames[i] = replace(self._frames[i], tracked=(host, T_kc.clone()))

    def _refined(self) -> list[int]:
        """The frames that were refined."""
        return [i for i in range(len(self)) if self.is_refined(i)]

    def _tracked(self, i: int) -> tuple[int, Tensor]:
        """Host and pose in it (4, 4) of a frame as it was tracked."""
        frame = self._frames[i]
        return frame.tracked or (frame.host, frame.T_kc)

    def append(self, timestamp: float, T_wc: Tensor, status: Status) -> None:
        """Adds a tracked frame with its stamp [s] and pose (4, 4), relative to the host of the last keyframe."""
        host, T_kc = self.graph.relative_to_host(T_wc)
        self._frames.append(_FramePose(host, T_kc, status, timestamp))

    def attach_last(self, keyframe: Keyframe) -> None:
        """Attaches the last frame, which has become a keyframe and was refined, to that keyframe's host.

        The first frame of a submap was not tracked in it: where it is counts as where it was tracked, not how far the submaps lie apart.
        """
        (host, T_kc), tracked = self.graph.relative_to_host(keyframe.T_wk), self._tracked(-1)
        begins = self.graph.keyframes[host].submap != self.graph.keyframes[tracked[0]].submap
        self._frames[-1] = replace(self._frames[-1], host=host, T_kc=T_kc, tracked=(host, T_kc) if begins else tracked)

    def is_refined(self, i: int) -> bool:
        """Whether the i-th frame was refined after it was tracked, as keyframes are."""
        return self._frames[i].tracked is not None

    def move(self, i: int, T_wc: Tensor) -> None:
        """Gives the i-th frame the pose `T_wc` (4, 4)."""
        frame = self._frames[i]
        self._frames[i] = replace(frame, T_kc=se3.orthonormal(se3.inverse(self.graph.keyframes[frame.host].T_wk) @ T_wc))

    def in_host(self, i: int) -> tuple[int, Tensor]:
        """The host of the i-th frame, and the frame's pose (4, 4) in it."""
        return self._frames[i].host, self._frames[i].T_kc

    @property
    def last_status(self) -> Status:
        """The status of the last frame."""
        return self._frames[-1].status

    @property
    def in_doubt(self) -> bool:
        """Whether the last frame was doubtful."""
        return len(self._frames) > 0 and self.last_status is Status.DOUBTFUL

    def last_pose(self, otherwise: Tensor) -> Tensor:
        """The pose (4, 4) float64 of the last frame; `otherwise` before the first one."""
        return self.T_wc(-1) if self._frames else otherwise

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

    def spread_corrections(self) -> None:
        """Moves the frames before each refined one by shares of its correction that grow with time, from none at the refined one before.

        A keyframe is corrected by registration and adjustments. The frames before it, which nothing corrects, were tracked like it, in the
        same map, and share its error the more, the nearer they are. Where it was drawn away alone, the motion of the camera tells so.
        """
        poses = np.stack([self.T_wc(i).numpy() for i in range(len(self))]) if len(self) else np.zeros((0, 4, 4))
        usual = usual_unevenness(poses, np.array([frame.timestamp for frame in self._frames]))
        for start, end in itertools.pairwise(self._refined()):
            if end > start + 1 and self._is_unbroken(start, end):
                self._spread(start, end, usual)

    def _is_unbroken(self, start: int, end: int) -> bool:
        """Whether all frames from `start` to `end` were tracked without a gap, and are of one submap."""
        tracked_in = self.graph.keyframes[self._tracked(end)[0]].submap
        frames = range(start, end + 1)
        return all(self._frames[i].status.measured and self.submap(i) == tracked_in for i in frames)

    def _spread(self, start: int, end: int, usual: float) -> None:
        """Turns each frame between `start` and `end` about itself, and shifts it, by its share of what `end` was corrected by.

        usual: by how much the motion is uneven as a rule [m].
        """
        host, T_kc = self._tracked(end)
        T_was, T_is = self.graph.keyframes[host].T_wk @ T_kc, self.T_wc(end)
        begun, span = self._frames[start].timestamp, self._frames[end].timestamp - self._frames[start].timestamp
        shares = [(frame.timestamp - begun) / span if span > 0 else 0.5 for frame in self._frames[start + 1 : end]]
        goes_on = end + 1 < len(self) and self._frames[end + 1].status.measured and self.submap(end + 1) == self.submap(end)
        beside = range(end - 2, end + 1 + goes_on)
        poses, stamps = np.stack([self.T_wc(i).numpy() for i in beside]), np.array([self._frames[i].timestamp for i in beside])
        moved = np.array([0.0, *shares][-2:] + [0.0] * (1 + goes_on))
        factor = shared(poses, stamps, moved, T_was.numpy(), T_is.numpy(), usual)
        self._correct(range(start + 1, end), [factor * share for share in shares], T_was, T_is)

    def correct_latest(self, T_was: Tensor, T_is: Tensor, share: float) -> None:
        """Moves the latest frames, back to the last refined one, each by `share` of what the frame after it is moved by.

        T_was, T_is: poses (4, 4) of a frame that is not appended yet, before it was corrected and after.
        """
        first = next((i + 1 for i in range(len(self) - 1, -1, -1) if self.is_refined(i) or not self._frames[i].status.measured), 0)
        frames = range(max(first, len(self) - _LATEST), len(self))
        self._correct(frames, [share ** (len(self) - i) for i in frames], T_was, T_is)

    def _correct(self, frames: range, shares: Sequence[float], T_was: Tensor, T_is: Tensor) -> None:
        """Turns frames about themselves, and shifts them, by shares of the change from a pose T_was (4, 4) to T_is."""
        shift, turn = T_is[:3, 3] - T_was[:3, 3], torch.eye(4, dtype=torch.float64)
        turn[:3, :3] = T_is[:3, :3] @ T_was[:3, :3].T
        turns = se3.exp(torch.tensor(shares, dtype=torch.float64)[:, None] * se3.log(turn))
        for i, share, turn in zip(frames, shares, turns):
            T_wc = self.T_wc(i)
            moved = turn @ T_wc
            moved[:3, 3] = T_wc[:3, 3] + share * shift
            self.move(i, moved)

    def trajectory(self) -> NDArray[np.float64]:
        """(N, 4, 4) poses of all frames. A frame outside the main submap has that of the last frame before it inside, or of the first."""
        main = self.graph.main_submap
        inside = [i for i in range(len(self)) if self.submap(i) == main]
        held = [inside[max(bisect_right(inside, i) - 1, 0)] for i in range(len(self))] if inside else []
        return np.stack([self.T_wc(i).numpy() for i in held]) if held else np.tile(np.eye(4), (len(self), 1, 1))

    def statuses(self) -> list[Status]:
        """The status of each frame. Frames outside the main submap count as lost."""
        main = self.graph.main_submap
        return [frame.status if self.submap(i) == main else Status.LOST for i, frame in enumerate(self._frames)]

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


def _stacked(poses: Sequence[Tensor]) -> Tensor:
    """(N, 4, 4)"""
    return torch.stack(list(poses)) if poses else torch.zeros(0, 4, 4, dtype=torch.float64)
