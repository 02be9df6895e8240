"""Keyframes and what connects them (Sec. IV-C): covisibility, culling, replay; every frame hangs on a keyframe."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.config import KeyframeConfig
from idfslam.frame import Frame, Status
from idfslam.geometry import se3
from idfslam.graph.covisibility import covisibility
from idfslam.mapping.meshing import View, reduced_view
from idfslam.mapping.sampling import CellPixels

_COVERAGE_ROWS = 120  # of the depth that is kept of each view the map learnt from
_COVERAGE_MOST = 1000


@dataclass(eq=False)
class Keyframe:
    """A frame that is kept, its pose, and what components remember of it."""

    frame: Frame
    T_wk: Tensor  # (4, 4) float64
    depth: Tensor  # (H, W) [m] on the map's device
    colour: Tensor  # (H, W, 3) in [0, 1] on the map's device
    described: Any = None  # the tracker's features of it
    cell_losses: Tensor | None = None  # (8, 8) for active sampling
    pixels: CellPixels | None = None  # its pixels with depth, by cell
    appearance: Any = None  # the aligner's image pyramid of it
    landmarks: Any = None  # the aligner's landmarks in it
    neighbours: set[int] = field(default_factory=set)  # stored keyframes it is connected with
    earlier: list[int] = field(default_factory=list)  # stored keyframes that see most of what it sees, oldest first

    @property
    def index(self) -> int:
        """Index of its frame in the recording."""
        return self.frame.index


@dataclass(frozen=True)
class _Link:
    """A frame relative to a stored keyframe, so that moving the keyframe moves it."""

    keyframe: int
    T_kc: Tensor
    status: Status
    timestamp: float


class KeyframeGraph:
    """Stored keyframes, the covisibility between them, and all frames relative to them."""

    def __init__(self, config: KeyframeConfig, generator: torch.Generator) -> None:
        self.config, self._generator = config, generator
        self.keyframes: list[Keyframe] = []
        self.reference: Keyframe | None = None  # the last frame that was chosen, whether stored or culled
        self._chosen_at = 0  # frames processed when that was
        self._links: list[_Link] = []
        self._coverage: list[tuple[int, View]] = []  # keyframe, and a view at its pose T_kc

    def __len__(self) -> int:
        return len(self._links)

    def append(self, timestamp: float, T_wc: Tensor, status: Status) -> None:
        """A tracked frame, to be remembered relative to the newest stored keyframe."""
        k = len(self.keyframes) - 1
        T_kc = se3.inverse(self.keyframes[k].T_wk) @ T_wc if k >= 0 else T_wc
        self._links.append(_Link(max(k, 0), T_kc, status, timestamp))

    def asks_for_keyframe(self, T_wc: Tensor, status: Status, in_view: float = 1.0) -> bool:
        """Enough motion since the last keyframe, or lost (Sec. III); or too little is left `in_view` of what frames are held against."""
        if self.reference is None or status is Status.LOST:
            return True
        if in_view < self.config.in_view and len(self) - self._chosen_at > self.config.in_view_every:
            return True
        T_kc = se3.inverse(self.reference.T_wk) @ T_wc
        moved, turned = float(T_kc[:3, 3].norm()), math.degrees(float(se3.angle(T_kc)))
        return moved > self.config.translation or turned > self.config.rotation

    def promote(self, keyframe: Keyframe) -> bool:
        """Store the newest frame as a keyframe, connected to those that see the same; False if it was culled.

        Its frame is the one appended last; either way it becomes the reference of the frames to come.
        """
        self.reference, self._chosen_at = keyframe, len(self)
        scores = self._covisibility(keyframe)
        keyframe.earlier = torch.nonzero(scores > self.config.shared).flatten().tolist()
        keyframe.neighbours.update(torch.nonzero(scores > self.config.covisible).flatten().tolist())
        if self.config.culling and len(scores) and float(scores.max()) > self.config.cull:
            self._link_last(len(self.keyframes) - 1, keyframe.T_wk)
            return False
        new = len(self.keyframes)
        for i in keyframe.neighbours:
            self.keyframes[i].neighbours.add(new)
        self.keyframes.append(keyframe)
        self._link_last(new, keyframe.T_wk)
        return True

    def _link_last(self, k: int, T_wc: Tensor) -> None:
        """Hang the newest frame, its pose refined, on stored keyframe k."""
        last = self._links[-1]
        self._links[-1] = _Link(k, se3.inverse(self.keyframes[k].T_wk) @ T_wc, last.status, last.timestamp)

    def _covisibility(self, keyframe: Keyframe) -> Tensor:
        """Eq. 5 against all stored keyframes: (K,)."""
        if not self.keyframes:
            return torch.zeros(0)
        T_kn = torch.stack([se3.inverse(k.T_wk) @ keyframe.T_wk for k in self.keyframes]).to(keyframe.depth)
        others = torch.stack([k.depth for k in self.keyframes]) if self.config.occlusion else None
        return covisibility(keyframe.depth, keyframe.frame.camera, T_kn, keyframe.frame.camera, others).cpu()

    def cover(self, view: Keyframe) -> None:
        """Remember what a view that the map learnt from has seen: its depth, reduced, relative to the newest stored keyframe."""
        k = len(self.keyframes) - 1
        T_kc = se3.inverse(self.keyframes[k].T_wk) @ view.T_wk
        small = reduced_view(T_kc.numpy(), view.frame.depth, view.frame.camera, _COVERAGE_ROWS)
        self._coverage.append((k, small))
        if len(self._coverage) > _COVERAGE_MOST:
            del self._coverage[1::2]  # every other: what is left still spreads over the whole run

    def views(self) -> list[View]:
        """All that was seen, at the poses that the keyframes have now."""
        return [View(self.keyframes[k].T_wk.numpy() @ view.T_wc, view.depth, view.camera) for k, view in self._coverage]

    def sample(self, count: int) -> list[Keyframe]:
        """`count` stored keyframes at random, or all if they are fewer."""
        return self._draw(self.keyframes, count)

    def references(self, count: int) -> list[Keyframe]:
        """The last chosen frame and, up to `count` in all, those of `earlier`."""
        return [] if self.reference is None else [self.reference, *self.earlier(self.reference, count - 1)][:count]

    def earlier(self, keyframe: Keyframe, count: int) -> list[Keyframe]:
        """Up to `count` keyframes that see most of what a stored one sees, the oldest first, all older than it: they have drifted least."""
        return [self.keyframes[i] for i in keyframe.earlier[:count]]

    def replay(self, keyframe: Keyframe) -> list[Keyframe]:
        """At most N_rep random stored keyframes that are not connected to `keyframe` (Sec. IV-C).

        Beyond the paper, `replay_connected` random ones that are: they keep the shared view an average of many.
        """
        apart: list[Keyframe] = []
        connected: list[Keyframe] = []
        for i, other in enumerate(self.keyframes):
            if other is not keyframe:
                (connected if i in keyframe.neighbours else apart).append(other)
        return self._draw(apart, self.config.replay) + self._draw(connected, self.config.replay_connected)

    def _draw(self, keyframes: list[Keyframe], count: int) -> list[Keyframe]:
        chosen = torch.randperm(len(keyframes), generator=self._generator)[:count]
        return [keyframes[i] for i in chosen.tolist()]

    def T_wc(self, i: int) -> Tensor:
        """Pose (4, 4) float64 of the i-th frame processed."""
        link = self._links[i]
        return self.keyframes[link.keyframe].T_wk @ link.T_kc if self.keyframes else link.T_kc

    def trajectory(self) -> NDArray[np.float64]:
        """(N, 4, 4) poses of all frames processed."""
        return np.stack([self.T_wc(i).numpy() for i in range(len(self))]) if len(self) else np.zeros((0, 4, 4))

    def statuses(self) -> list[Status]:
        """How each frame's pose was found."""
        return [link.status for link in self._links]
