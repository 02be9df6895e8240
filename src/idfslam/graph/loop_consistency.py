"""Loops: keyframes that turn out to show a place seen before, although the chain of measurements between them has drifted.

A loop is believed if it corrects no more than the way between its keyframes may have drifted (places that look alike lie farther off),
if the next loop says the same, and if the pose graph can be reconciled with it.
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
from idfslam.graph.path_length import edge_pairs, path_lengths
from idfslam.graph.pose_graph import Edge, optimise
from idfslam.storage.state import State

log = logging.getLogger(__name__)

_LINK = (0.01, 0.02), (0.004, 0.02)  # standard deviation of a link: [m] and per metre, [rad] and per radian
_LOOP = 0.005, 0.002  # of a loop [m], [rad]: it comes from an alignment, too, and has crossed no distance
_SETTLED = 0.01, math.radians(0.3)  # a smaller disagreement is no drift, and the two keyframes are simply linked
_OVERLAP = 1.5, math.radians(40)  # [m], [rad] between two views of one place that the tracker can register


@dataclass(frozen=True)
class Loop:
    """Keyframe b, seen again from where keyframe a was."""

    a: int
    b: int
    T_ab: Tensor  # (4, 4) float64, measured
    view: int  # the frame that showed it: b, or one that hangs on b

    def disagreement(self, graph: KeyframeGraph) -> Tensor:
        """(4, 4) what the loop would turn the present pose of b into, in b's own frame."""
        return se3.inverse(graph.keyframes[self.b].T_wk) @ graph.keyframes[self.a].T_wk @ self.T_ab


def plain_loop(loop: Loop) -> State:
    """A loop for a state."""
    return {"a": loop.a, "b": loop.b, "T_ab": loop.T_ab, "view": loop.view}


def loop_from(state: State) -> Loop:
    """The loop that `plain_loop` told."""
    return Loop(**state)


def same_correction(graph: KeyframeGraph, loop: Loop, other: Loop, within: float) -> bool:
    """Whether two loops of different views, no farther than `within` [m] from each other, ask for the same correction."""
    if loop.view == other.view:
        return False
    T_between = se3.inverse(graph.keyframes[loop.b].T_wk) @ graph.keyframes[other.b].T_wk
    difference = se3.inverse(loop.disagreement(graph)) @ T_between @ other.disagreement(graph) @ se3.inverse(T_between)
    apart = float(T_between[:3, 3].norm())
    near = float(difference[:3, 3].norm()) < 0.02 + 0.05 * apart and float(se3.angle(difference)) < math.radians(1.0)
    return near and apart < within


class Loops:
    """The loops of a run: those believed, one that waits to be confirmed, and how many were refused."""

    def __init__(self, config: LoopConfig) -> None:
        self.config = config
        self.closed: list[Loop] = []
        self.refused = 0
        self.waiting: Loop | None = None

    def state(self) -> State:
        """Loops by their keyframes' numbers."""
        closed, waiting = [plain_loop(loop) for loop in self.closed], None if self.waiting is None else plain_loop(self.waiting)
        return {"closed": closed, "waiting": waiting, "refused": self.refused}

    def restore(self, state: State) -> None:
        """What `state` told."""
        self.closed, self.refused = [loop_from(loop) for loop in state["closed"]], state["refused"]
        self.waiting = None if state["waiting"] is None else loop_from(state["waiting"])

    def within_reach(self, graph: KeyframeGraph, keyframe: Keyframe) -> list[int]:
        """Stored keyframes of its piece, not linked with a chosen one, that may yet see the same, whatever drift there may be between."""
        ways = path_lengths(graph.keyframes, keyframe.host)
        apart = [i for i in graph.beyond(keyframe, ways) if graph.keyframes[i].submap == keyframe.submap]
        if not apart:
            return []
        T = torch.stack([graph.keyframes[i].T_wk for i in apart])
        change = se3.inverse(keyframe.T_wk) @ T
        shift, turn = change[:, :3, 3].norm(dim=1).numpy(), se3.angle(change).numpy()
        allowed, turn_allowed = self._allowed(ways[apart])
        near = (shift < allowed + _OVERLAP[0]) & (turn < turn_allowed + _OVERLAP[1])
        return [i for i, reachable in zip(apart, near) if reachable]

    def _allowed(self, way: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """How much a loop may correct after `way` [m]: [m] and [rad]."""
        c = self.config
        return c.slack + c.drift * way, np.radians(c.turn_slack + c.turn_drift * way)

    def offer(self, graph: KeyframeGraph, loop: Loop) -> list[float]:
        """A verified loop. Where it closes, the graph's poses follow: how far [m] each keyframe moved; nothing where none did.

        Without drift to speak of there is nothing to close: the two keyframes are linked.
        """
        change = loop.disagreement(graph)
        shift, turn = float(change[:3, 3].norm()), float(se3.angle(change))
        if shift < _SETTLED[0] and turn < _SETTLED[1]:
            graph.add_edge(graph.keyframes[loop.b], loop.a)
            return []
        way = path_lengths(graph.keyframes, loop.a)[loop.b]
        allowed, turn_allowed = self._allowed(way)
        if shift > allowed or turn > turn_allowed:
            self._refuse(loop, f"it would correct {shift:.2f} m and {math.degrees(turn):.1f} degrees after {way:.1f} m")
            return []
        if self.waiting is None or not same_correction(graph, self.waiting, loop, self.config.confirmed_within):
            self.waiting = loop
            return []
        return self._close(graph, [self.waiting, loop])

    def forget_between(self, graph: KeyframeGraph) -> None:
        """After the graph was cut: loops between pieces were none."""
        self.closed = [loop for loop in self.closed if graph.keyframes[loop.a].submap == graph.keyframes[loop.b].submap]
        self.waiting = None

    def _close(self, graph: KeyframeGraph, new: list[Loop]) -> list[float]:
        """The pose graph with all loops, old and new; those that it cannot be reconciled with are dropped."""
        self.waiting = None
        loops = [*self.closed, *new]
        edges = links(graph) + [Edge(loop.a, loop.b, loop.T_ab, *_LOOP, loop=True) for loop in loops]
        poses, believed = optimise([k.T_wk for k in graph.keyframes], edges)
        if not any(believed[len(self.closed) :]):
            self._refuse(new[-1], "the pose graph contradicts it")
            return []
        for loop, stands in zip(loops, believed, strict=True):
            if not stands:
                self._refuse(loop, "the pose graph contradicts it")
        self.closed = [loop for loop, stands in zip(loops, believed, strict=True) if stands]
        moved = graph.move(poses)
        for loop in self.closed:
            graph.add_edge(graph.keyframes[loop.b], loop.a)
        a, b = (graph.keyframes[i].index for i in (new[-1].a, new[-1].b))
        log.info("loop closed between frames %d and %d: keyframes moved by up to %.1f cm", a, b, 100 * max(moved))
        return moved

    def summary(self, graph: KeyframeGraph) -> dict[str, Any]:
        """Links and loops between keyframes, as metrics.json tells them; loops by the frames' indices."""
        closed = [[graph.keyframes[loop.a].index, loop.view] for loop in self.closed]
        links = sum(len(keyframe.edges) for keyframe in graph.keyframes) // 2
        return {"links": links, "loops": closed, "loops_refused": self.refused}

    def _refuse(self, loop: Loop, why: str) -> None:
        self.refused += 1
        log.info("loop between keyframes %d and %d refused: %s", loop.a, loop.b, why)


def links(graph: KeyframeGraph) -> list[Edge]:
    """The measured relations between stored keyframes, as the present poses have them."""
    a, b = edge_pairs(graph.keyframes)
    T = torch.stack([keyframe.T_wk for keyframe in graph.keyframes])
    T_ab = se3.inverse(T[a]) @ T[b]
    translation = (_LINK[0][0] + _LINK[0][1] * T_ab[:, :3, 3].norm(dim=1)).tolist()
    rotation = (_LINK[1][0] + _LINK[1][1] * se3.angle(T_ab)).tolist()
    return [Edge(*edge) for edge in zip(a.tolist(), b.tolist(), T_ab, translation, rotation)]
