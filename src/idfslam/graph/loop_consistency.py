"""Loop consistency: which of the verified loops are accepted.

A loop must pass three tests. Its correction is no larger than the drift that the path between its keyframes allows: places that only look
alike are usually farther apart. A second loop gives the same correction. The pose graph with the loop passes a chi-square test.
"""

import logging
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.config import LoopConfig
from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.measured_edges import measured_edges
from idfslam.graph.path_length import path_lengths
from idfslam.graph.pose_graph import Edge, optimise
from idfslam.storage.state import State

log = logging.getLogger(__name__)

# All of these were chosen by hand. With them no wrong loop passes in ten corridors with look-alike doors (docs/results.md).

# Standard deviation of a loop [m], [rad]; it comes from one alignment, whatever the path's length. More: loops correct less.
_LOOP_SIGMA = 0.005, 0.002
# [m], [rad] Correction below which the two keyframes get an edge instead of a loop. More: small drift stays.
_NO_DRIFT = 0.01, math.radians(0.3)
# [m], [rad] Largest difference of two views that the tracker can register. More: more candidates for each keyframe, more time.
_OVERLAP = 1.5, math.radians(40)
# [m], [m per m between the loops], [rad] Largest difference of two equal corrections. More: look-alike places pass more easily.
_SAME = 0.02, 0.05, math.radians(1.0)


@dataclass(frozen=True)
class Loop:
    """A measured relative pose of two keyframes: b sees again what a saw before."""

    a: int
    b: int
    T_ab: Tensor  # (4, 4) float64
    view: int  # index of the frame that was measured: that of b, or of a culled keyframe whose host is b

    @classmethod
    def to(cls, keyframe: Keyframe, graph: KeyframeGraph, a: int, T_wc: Tensor) -> "Loop":
        """The loop from stored keyframe a to a keyframe, stored or culled, which a measures at the pose T_wc (4, 4)."""
        T_wb = graph.keyframes[keyframe.host].T_wk
        T_ab = se3.inverse(graph.keyframes[a].T_wk) @ T_wc @ se3.inverse(keyframe.T_wk) @ T_wb
        return cls(a, keyframe.host, T_ab, keyframe.index)

    def disagreement(self, graph: KeyframeGraph) -> Tensor:
        """The correction (4, 4) that the loop implies for the present pose of b, in b's own frame."""
        return se3.inverse(graph.keyframes[self.b].T_wk) @ graph.keyframes[self.a].T_wk @ self.T_ab

    def state(self) -> State:
        """The loop as a state."""
        return {"a": self.a, "b": self.b, "T_ab": self.T_ab, "view": self.view}

    @classmethod
    def from_state(cls, state: State) -> "Loop":
        """The loop that `state` was made from."""
        return cls(**state)


def same_correction(graph: KeyframeGraph, loop: Loop, other: Loop, within: float) -> bool:
    """Whether two loops of different views, at most `within` [m] apart, imply the same correction."""
    if loop.view == other.view:
        return False
    T_between = se3.inverse(graph.keyframes[loop.b].T_wk) @ graph.keyframes[other.b].T_wk
    difference = se3.inverse(loop.disagreement(graph)) @ T_between @ other.disagreement(graph) @ se3.inverse(T_between)
    apart = float(T_between[:3, 3].norm())
    near = float(difference[:3, 3].norm()) < _SAME[0] + _SAME[1] * apart and float(se3.angle(difference)) < _SAME[2]
    return near and apart < within


class LoopConsistency:
    """The loops of a run: the closed ones, one that waits for confirmation, and the number of refused ones."""

    def __init__(self, config: LoopConfig) -> None:
        self.config = config
        self.closed: list[Loop] = []
        self.refused = 0
        self.waiting: Loop | None = None

    def state(self) -> State:
        """The closed loops, the waiting one, and the number of refused ones."""
        closed, waiting = [loop.state() for loop in self.closed], None if self.waiting is None else self.waiting.state()
        return {"closed": closed, "waiting": waiting, "refused": self.refused}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.closed, self.refused = [Loop.from_state(loop) for loop in state["closed"]], state["refused"]
        self.waiting = None if state["waiting"] is None else Loop.from_state(state["waiting"])

    def within_reach(self, graph: KeyframeGraph, keyframe: Keyframe) -> list[int]:
        """Stored keyframes of the same submap, beyond a short path, that may be covisible with a keyframe once drift is corrected."""
        lengths = path_lengths(graph.keyframes, keyframe.host)
        distant = [i for i in graph.beyond(keyframe, lengths) if graph.keyframes[i].submap == keyframe.submap]
        if not distant:
            return []
        T = torch.stack([graph.keyframes[i].T_wk for i in distant])
        change = se3.inverse(keyframe.T_wk) @ T
        shift, turn = change[:, :3, 3].norm(dim=1).numpy(), se3.angle(change).numpy()
        allowed, turn_allowed = self._allowed(lengths[distant])
        near = (shift < allowed + _OVERLAP[0]) & (turn < turn_allowed + _OVERLAP[1])
        return [i for i, reachable in zip(distant, near) if reachable]

    def _allowed(self, length: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The largest correction [m], [rad] of a loop after a path of `length` [m]."""
        c = self.config
        return c.slack + c.drift * length, np.radians(c.turn_slack + c.turn_drift * length)

    def offer(self, graph: KeyframeGraph, loop: Loop) -> list[float]:
        """Tests a verified loop; if it is accepted, optimises the graph. Returns how far [m] each keyframe moved; empty if none moved.

        Without drift the two keyframes get an edge instead.
        """
        change = loop.disagreement(graph)
        shift, turn = float(change[:3, 3].norm()), float(se3.angle(change))
        if shift < _NO_DRIFT[0] and turn < _NO_DRIFT[1]:
            graph.add_edge(graph.keyframes[loop.b], loop.a)
            return []
        length = path_lengths(graph.keyframes, loop.a)[loop.b]
        allowed, turn_allowed = self._allowed(length)
        if shift > allowed or turn > turn_allowed:
            self._refuse(loop, f"it would correct {shift:.2f} m and {math.degrees(turn):.1f} degrees after {length:.1f} m")
            return []
        if self.waiting is None or not same_correction(graph, self.waiting, loop, self.config.confirmed_within):
            self.waiting = loop
            return []
        return self._close(graph, [self.waiting, loop])

    def forget_between(self, graph: KeyframeGraph) -> None:
        """Forgets the loops between submaps and the waiting one, after a submap was split off: they were wrong."""
        self.closed = [loop for loop in self.closed if graph.keyframes[loop.a].submap == graph.keyframes[loop.b].submap]
        self.waiting = None

    def _close(self, graph: KeyframeGraph, new: list[Loop]) -> list[float]:
        """Optimises the pose graph with all loops, old and new, and refuses those that fail the chi-square test."""
        self.waiting = None
        loops = [*self.closed, *new]
        edges = measured_edges(graph) + [Edge(loop.a, loop.b, loop.T_ab, *_LOOP_SIGMA, loop=True) for loop in loops]
        poses, kept = optimise([k.T_wk for k in graph.keyframes], edges)
        if not any(kept[len(self.closed) :]):
            self._refuse(new[-1], "the pose graph contradicts it")
            return []
        for loop, is_kept in zip(loops, kept, strict=True):
            if not is_kept:
                self._refuse(loop, "the pose graph contradicts it")
        self.closed = [loop for loop, is_kept in zip(loops, kept, strict=True) if is_kept]
        moved = graph.move(poses)
        for loop in self.closed:
            graph.add_edge(graph.keyframes[loop.b], loop.a)
        a, b = (graph.keyframes[i].index for i in (new[-1].a, new[-1].b))
        log.info("loop closed between frames %d and %d: keyframes moved by up to %.1f cm", a, b, 100 * max(moved))
        return moved

    def summary(self, graph: KeyframeGraph) -> dict[str, Any]:
        """The loops for metrics.json, by the frames' indices."""
        closed = [[graph.keyframes[loop.a].index, loop.view] for loop in self.closed]
        return {"loops": closed, "loops_refused": self.refused}

    def _refuse(self, loop: Loop, why: str) -> None:
        self.refused += 1
        log.info("loop between keyframes %d and %d refused: %s", loop.a, loop.b, why)
