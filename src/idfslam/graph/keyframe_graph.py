"""Keyframes and what connects them (Sec. IV-C): covisibility, culling, replay; every frame hangs on a keyframe."""

import bisect
import itertools
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.config import KeyframeConfig
from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.geometry.depth_view import DepthView, reduced_view
from idfslam.graph.archive import Archive
from idfslam.graph.covisibility import covisibility
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.path_length import ways_from
from idfslam.graph.submaps import brought_together, far_from
from idfslam.storage.state import State

_COVERAGE_ROWS = 120  # of the depth that is kept of each view the map learnt from
_COVERAGE_MOST = 1000
_CANDIDATES = 4  # stored keyframes that are looked at more closely for the most covisible


Revive = Callable[[State], Keyframe]
"""A keyframe's state -> the keyframe, with its images again."""


@dataclass(frozen=True)
class _Link:
    """A frame relative to a stored keyframe, so that moving the keyframe moves it."""

    keyframe: int
    T_kc: Tensor
    status: Status
    timestamp: float


def _columns(links: list[_Link]) -> State:
    return {
        "keyframe": [link.keyframe for link in links],
        "T_kc": torch.stack([link.T_kc for link in links]) if links else torch.zeros(0, 4, 4, dtype=torch.float64),
        "status": [link.status.value for link in links],
        "timestamp": [link.timestamp for link in links],
    }


def _rows(columns: State) -> list[_Link]:
    values = zip(columns["keyframe"], columns["T_kc"], columns["status"], columns["timestamp"])
    return [_Link(k, T_kc.clone(), Status(status), timestamp) for k, T_kc, status, timestamp in values]


class KeyframeGraph:
    """Stored keyframes, the covisibility between them, and all frames relative to them."""

    def __init__(self, config: KeyframeConfig, generator: torch.Generator, *, verify: bool = False) -> None:
        """verify: covisible keyframes count as linked only where measurements lead to them; off: all of them, as in the paper."""
        self.config, self._generator, self.verify = config, generator, verify
        self.archive = Archive(config.in_memory)
        self.keyframes: list[Keyframe] = []
        self.reference: Keyframe | None = None  # the last frame that was chosen, whether stored or culled
        self._chosen_at = 0  # frames processed when that was
        self.trial: int | None = None  # the first keyframe stored at a place found by its looks, while that may yet prove wrong (trial.py)
        self._links: list[_Link] = []
        self._coverage: list[tuple[int, DepthView]] = []  # keyframe, and a view at its pose T_kc

    def __len__(self) -> int:
        return len(self._links)

    def state(self) -> State:
        """Keyframes, frames and coverage. The reference is the number of a stored keyframe, or its own state where it was culled."""
        stored = self.reference in self.keyframes
        culled = None if stored or self.reference is None else self.reference.state()
        return {
            "keyframes": [keyframe.state() for keyframe in self.keyframes],
            "reference": self.keyframes.index(self.reference) if self.reference is not None and stored else culled,
            "chosen_at": self._chosen_at,
            "trial": -1 if self.trial is None else self.trial,
            "links": _columns(self._links),
            "coverage": [
                {"keyframe": k, "T_kc": torch.from_numpy(view.T_wc), "depth": torch.from_numpy(view.depth), "camera": asdict(view.camera)}
                for k, view in self._coverage
            ],
            "generator": self._generator.get_state(),
        }

    def restore(self, state: State, revive: Revive) -> None:
        """What `state` told; `revive` gives the keyframes their images again."""
        for kept in state["keyframes"]:
            self.keyframes.append(revive(kept))
            self.keyframes[-1].keep_in(self.archive)
        reference = state["reference"]
        self.reference = self.keyframes[reference] if isinstance(reference, int) else reference and revive(reference)
        self._chosen_at = state["chosen_at"]
        self.trial = None if state["trial"] < 0 else state["trial"]
        self._links = _rows(state["links"])
        self._coverage = [
            (kept["keyframe"], DepthView(kept["T_kc"].numpy(), kept["depth"].numpy(), Camera(**kept["camera"])))
            for kept in state["coverage"]
        ]
        self._generator.set_state(state["generator"])

    def append(self, timestamp: float, T_wc: Tensor, status: Status) -> None:
        """A tracked frame, to be remembered relative to the stored keyframe that the last chosen one hangs on."""
        k = self.reference.anchor if self.reference else 0
        T_kc = se3.inverse(self.keyframes[k].T_wk) @ T_wc if self.keyframes else T_wc
        self._links.append(_Link(k, T_kc, status, timestamp))

    def asks_for_keyframe(self, T_wc: Tensor, status: Status, in_view: float = 1.0) -> bool:
        """Enough motion since the last keyframe, or lost (Sec. III); or too little is left `in_view` of what frames are held against."""
        if self.reference is None or status is Status.LOST or self.trial == len(self.keyframes):
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
        scores, reach = self._covisibility(keyframe), self._reach()
        covisible = torch.nonzero(scores > self.config.covisible).flatten().tolist()
        keyframe.neighbours.update(covisible)
        keyframe.linked = {i for i in covisible if i in reach}
        if self.reference is not None:
            keyframe.linked.add(self.reference.anchor)
        keyframe.unlinked = sorted(keyframe.neighbours - keyframe.linked, key=lambda i: -float(scores[i]))
        keyframe.alike = torch.nonzero(scores > self.config.shared).flatten().tolist()
        self.reference, self._chosen_at = keyframe, len(self)
        cover = self._cover(keyframe, scores)
        stored = cover is None
        keyframe.anchor = len(self.keyframes) if cover is None else cover
        keyframe.piece = min((self.keyframes[i].piece for i in keyframe.linked), default=keyframe.anchor)
        if stored:
            self._store(keyframe)
        last = self._links[-1]
        self._links[-1] = _Link(keyframe.anchor, self._relative(keyframe), last.status, last.timestamp)
        return stored

    def _cover(self, keyframe: Keyframe, scores: Tensor) -> int | None:
        """The linked stored keyframe that makes the new one superfluous: it sees the same, from hardly farther off; None if none does."""
        near = self.config.cull_reach * float(keyframe.depth[keyframe.depth > 0].median())
        covers = [i for i in keyframe.linked if float(scores[i]) > self.config.cull and i >= (self.trial or 0)]
        if self.config.cull_reach:
            covers = [i for i in covers if float((self.keyframes[i].T_wk - keyframe.T_wk)[:3, 3].norm()) < near]
        return max(covers, key=lambda i: float(scores[i]), default=None)

    def adopt(self, keyframe: Keyframe) -> None:
        """Store a keyframe of an earlier run, before this one's first frame: its pose is known beside all others'."""
        scores = self._covisibility(keyframe)
        keyframe.anchor = len(self.keyframes)
        keyframe.neighbours.update(torch.nonzero(scores > self.config.covisible).flatten().tolist())
        keyframe.linked = set(keyframe.neighbours) | ({keyframe.anchor - 1} if self.keyframes else set())
        keyframe.alike = torch.nonzero(scores > self.config.shared).flatten().tolist()
        self._store(keyframe)
        self.reference = keyframe

    def _store(self, keyframe: Keyframe) -> None:
        self.keyframes.append(keyframe)
        keyframe.keep_in(self.archive)
        for i in keyframe.neighbours:
            self.keyframes[i].neighbours.add(keyframe.anchor)
        for i in keyframe.linked:
            self.keyframes[i].linked.add(keyframe.anchor)

    def _reach(self) -> Collection[int]:
        """Stored keyframes whose pose relative to the last chosen one was measured, over no long way."""
        if not self.verify or self.reference is None:
            return range(len(self.keyframes))
        return self._near(self.reference, ways_from(self.keyframes, self.reference.anchor))

    def _near(self, keyframe: Keyframe, ways: NDArray[np.float64]) -> set[int]:
        """Stored keyframes to which only a short way of measured relations leads from a chosen one; ways (K,) [m] from its anchor."""
        return {keyframe.anchor, *keyframe.linked, *np.flatnonzero(ways <= self.config.edge_length).tolist()}

    def link(self, keyframe: Keyframe, i: int) -> None:
        """The pose of a chosen keyframe relative to stored keyframe `i` was measured: each may serve the other as a reference."""
        keyframe.linked.add(i)
        if i < keyframe.anchor and i not in keyframe.alike:
            bisect.insort(keyframe.alike, i)
        if self.keyframes[keyframe.anchor] is keyframe:
            self.keyframes[i].linked.add(keyframe.anchor)

    def apart(self, keyframe: Keyframe, ways: NDArray[np.float64]) -> list[int]:
        """Stored keyframes that no short way of measured relations connects with a chosen one; ways (K,) [m] from its anchor."""
        near = self._near(keyframe, ways)
        return [i for i in range(len(self.keyframes)) if i not in near]

    def status(self) -> Status:
        """How the newest frame's pose was found."""
        return self._links[-1].status

    def _relative(self, view: Keyframe) -> Tensor:
        """A view's pose in the keyframe that the last chosen one hangs on."""
        assert self.reference is not None
        return se3.inverse(self.keyframes[self.reference.anchor].T_wk) @ view.T_wk

    def settle(self, view: Keyframe, keyframe: Keyframe) -> None:
        """A lost view was found again beside a stored keyframe: frames to come are held against that one, and the place is on trial."""
        self.reference = keyframe
        view.anchor = keyframe.anchor
        self.trial = len(self.keyframes)

    def begin_piece(self) -> Tensor:
        """What comes next is not connected with what is stored: the next frame chosen begins a piece. A pose T_wc (4, 4) for it."""
        self.reference = self.trial = None
        return far_from(self.keyframes)

    @property
    def begins_piece(self) -> bool:
        """Whether the next frame chosen belongs to no piece that is stored."""
        return self.reference is None

    def join(self, a: int, b: int, T_ab: Tensor) -> list[float]:
        """Two pieces become one by a measured relation (4, 4) of two keyframes: how far [m] each keyframe moved."""
        pieces = self.keyframes[a].piece, self.keyframes[b].piece
        moved = self.move(brought_together(self.keyframes, a, b, T_ab))
        for keyframe in self.keyframes if self.reference is None else [*self.keyframes, self.reference]:
            if keyframe.piece == max(pieces):
                keyframe.piece = min(pieces)
        self.link(self.keyframes[b], a)
        self.trial = None  # what was found before says nothing of where the pieces meet
        return moved

    def cut(self) -> list[Keyframe]:
        """What was stored at the place on trial becomes a piece of its own; the old keyframes that it was taken to lie beside."""
        first, self.trial = self.trial, None
        assert first is not None
        old, new = self.keyframes[:first], self.keyframes[first:]
        beside = sorted({i for keyframe in new for i in keyframe.neighbours if i < first})
        for keyframe in old:
            keyframe.neighbours, keyframe.linked = ({i for i in known if i < first} for known in (keyframe.neighbours, keyframe.linked))
        for keyframe in new if self.reference is None else [*new, self.reference]:
            keyframe.neighbours, keyframe.linked = ({i for i in known if i >= first} for known in (keyframe.neighbours, keyframe.linked))
            keyframe.unlinked, keyframe.alike = ([i for i in known if i >= first] for known in (keyframe.unlinked, keyframe.alike))
            keyframe.piece = first
        change = far_from(self.keyframes) @ se3.inverse(new[0].T_wk)
        self.move([*(k.T_wk for k in old), *(se3.orthonormal(change @ k.T_wk) for k in new)])
        gap = next(i for i, link in enumerate(self._links) if link.keyframe >= first) - 1
        while gap >= 0 and self._links[gap].status is Status.INTERPOLATED:
            self._links[gap] = replace(self._links[gap], status=Status.LOST)
            gap -= 1
        return [self.keyframes[i] for i in beside]

    @property
    def placed(self) -> list[Keyframe]:
        """The stored keyframes of the first piece."""
        return [keyframe for keyframe in self.keyframes if keyframe.piece == 0]

    def piece(self, i: int) -> int:
        """The piece that the i-th frame processed belongs to."""
        return self.keyframes[self._links[i].keyframe].piece if self.keyframes else 0

    def bridge(self) -> int:
        """Lost frames between two of one piece whose poses were found get poses between these. How many they are."""
        known = [i for i, link in enumerate(self._links) if link.status is not Status.LOST]
        return sum(self._bridge(i, j) for i, j in itertools.pairwise(known) if j > i + 1 and self.piece(i) == self.piece(j))

    def _bridge(self, start: int, end: int) -> int:
        """The frames between these two."""
        T_before, T_after = self.T_wc(start), self.T_wc(end)
        t_before, span = self._links[start].timestamp, self._links[end].timestamp - self._links[start].timestamp
        step = se3.log(se3.inverse(T_before) @ T_after)
        for i in range(start + 1, end):
            link = self._links[i]
            share = (link.timestamp - t_before) / span if span > 0 else 0.5
            T_kc = se3.inverse(self.keyframes[link.keyframe].T_wk) @ T_before @ se3.exp(share * step)
            self._links[i] = _Link(link.keyframe, T_kc, Status.INTERPOLATED, link.timestamp)
        return end - start - 1

    def move(self, poses: Sequence[Tensor]) -> list[float]:
        """New poses T_wk of all stored keyframes; what hangs on them follows. How far [m] each moves a point two metres ahead, at most."""
        changes = []
        if self.reference is not None and self.keyframes[self.reference.anchor] is not self.reference:
            self.reference.T_wk = poses[self.reference.anchor] @ self._relative(self.reference)
        for keyframe, T_wk in zip(self.keyframes, poses, strict=True):
            T = se3.inverse(keyframe.T_wk) @ T_wk
            changes.append(float(T[:3, 3].norm() + 2 * se3.angle(T)))
            keyframe.T_wk = T_wk
        return changes

    def _covisibility(self, keyframe: Keyframe) -> Tensor:
        """Eq. 5 against all stored keyframes: (K,)."""
        if not self.keyframes:
            return torch.zeros(0)
        T_kn = (se3.inverse(torch.stack([k.T_wk for k in self.keyframes])) @ keyframe.T_wk).to(keyframe.depth)
        return covisibility(keyframe.depth, keyframe.camera, T_kn, keyframe.camera).cpu()

    def cover(self, view: Keyframe) -> None:
        """Remember what a view that the map learnt from has seen: its depth, reduced, relative to a stored keyframe."""
        assert self.reference is not None
        small = reduced_view(self._relative(view).numpy(), view.frame.depth, view.frame.camera, _COVERAGE_ROWS)
        self._coverage.append((self.reference.anchor, small))
        if len(self._coverage) > _COVERAGE_MOST:
            del self._coverage[1::2]  # every other: what is left still spreads over the whole run

    def cover_with(self, views: Sequence[DepthView]) -> None:
        """Remember what an earlier run has seen, each view relative to the stored keyframe that is nearest."""
        centres = torch.stack([k.T_wk[:3, 3] for k in self.keyframes]).numpy()
        for view in views:
            k = int(np.linalg.norm(centres - view.T_wc[:3, 3], axis=1).argmin())
            T_kc = se3.inverse(self.keyframes[k].T_wk).numpy() @ view.T_wc
            self._coverage.append((k, DepthView(T_kc, view.depth, view.camera)))

    def views(self) -> list[DepthView]:
        """All that was seen in the first piece, at the poses that its keyframes have now."""
        placed = [(self.keyframes[k], view) for k, view in self._coverage if self.keyframes[k].piece == 0]
        return [DepthView(keyframe.T_wk.numpy() @ view.T_wc, view.depth, view.camera) for keyframe, view in placed]

    def sample(self, count: int) -> list[Keyframe]:
        """`count` stored keyframes at random, or all if they are fewer."""
        return self._draw(self.keyframes, count)

    def references(self, count: int) -> list[Keyframe]:
        """The last chosen frame and, up to `count` in all, `earlier` ones."""
        return [] if self.reference is None else self.beside(self.reference, count)[:count]

    def tracking_references(self, frame: Keyframe) -> list[Keyframe]:
        """The keyframes to register a frame against, the next where it is lost against one: by `KeyframeConfig.reference`.

        The most covisible is that of the stored ones, and the last, that shares most with the frame at the pose it has so far.
        """
        if self.reference is None:
            return []
        if self.config.reference == "last" or not frame.has_depth:
            return [self.reference]
        most = self._covisibility(frame).topk(min(_CANDIDATES, len(self.keyframes))).indices.sort().values.tolist()
        candidates = [self.reference, *(self.keyframes[i] for i in most)]
        chosen = max(candidates, key=lambda k: self._shared(frame, k))
        return [chosen] if chosen is self.reference else [chosen, self.reference]

    def _shared(self, a: Keyframe, b: Keyframe) -> float:
        """Eq. 5 both ways, the lesser: a view from afar has all of a near one in view, but shows little of it."""
        T_ba = se3.inverse(b.T_wk) @ a.T_wk
        ways = ((a, b, T_ba), (b, a, se3.inverse(T_ba)))
        return min(float(covisibility(n.depth, n.camera, T[None].to(n.depth), k.camera, k.depth[None])) for n, k, T in ways)

    def earlier(self, keyframe: Keyframe, count: int) -> list[Keyframe]:
        """Up to `count` keyframes that see most of what a stored one sees, the oldest first, all older than it: they have drifted least."""
        return [self.keyframes[i] for i in keyframe.alike if i in keyframe.linked][:count]

    def beside(self, keyframe: Keyframe, count: int) -> list[Keyframe]:
        """What a view found beside a stored keyframe is held against: that one and, up to `count` in all, `earlier` ones."""
        return [keyframe, *self.earlier(keyframe, count - 1)]

    def replay(self, keyframe: Keyframe) -> list[Keyframe]:
        """At most N_rep random stored keyframes that are not connected to `keyframe` (Sec. IV-C).

        Beyond the paper, `replay_connected` random ones that are: they keep the shared view an average of many. And where a loop has
        moved keyframes, as many of those instead, the nearest first, until the map has followed.
        """
        if unlearnt := [k for k in self.keyframes if k.unlearnt and k is not keyframe]:
            unlearnt.sort(key=lambda k: float((k.T_wk - keyframe.T_wk)[:3, 3].norm()))
            return unlearnt[: self.config.replay + self.config.replay_connected]
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
        """(N, 4, 4) poses of all frames processed; a frame of another piece than the first has that of the last one before it."""
        poses: list[NDArray[np.float64]] = []
        for i in range(len(self)):
            poses.append(self.T_wc(i).numpy() if self.piece(i) == 0 else poses[-1] if poses else np.eye(4))
        return np.stack(poses) if poses else np.zeros((0, 4, 4))

    def statuses(self) -> list[Status]:
        """How each frame's pose was found; those of other pieces than the first count as lost."""
        return [link.status if self.piece(i) == 0 else Status.LOST for i, link in enumerate(self._links)]
