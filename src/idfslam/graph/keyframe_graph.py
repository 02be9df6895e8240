"""The keyframe graph (Sec. IV-C): stored keyframes, their covisibility, and the edges whose relative poses were measured."""

import bisect
from collections import Counter
from collections.abc import Callable, Collection, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.config import KeyframeConfig
from idfslam.geometry import se3
from idfslam.geometry.pose_distance import shift_ahead
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_covisibility import covisibilities, mutual_covisibility, unmasked_covisibility
from idfslam.graph.path_length import path_lengths
from idfslam.graph.submaps import merged_poses, separate_origin
from idfslam.graph.swap_file import SwapFile
from idfslam.storage.state import State

_CANDIDATES = 4  # stored keyframes whose mutual covisibility is tested. More: a better choice, at two tests each. Chosen by hand

Revive = Callable[[State], Keyframe]
"""A keyframe's state -> the keyframe, with its images again."""


class KeyframeGraph:
    """Stored keyframes, connected by covisibility and by measured edges. Only the graph moves keyframes."""

    def __init__(self, config: KeyframeConfig, *, verify: bool = False) -> None:
        """verify: a new keyframe gets edges only to keyframes at a short path of measured edges. False: to all covisible ones (paper)."""
        self.config, self.verify = config, verify
        self.swap = SwapFile(config.in_memory)
        self.keyframes: list[Keyframe] = []
        self.last_keyframe: Keyframe | None = None  # the last selected frame, stored or culled
        self.unverified_from: int | None = None  # the first keyframe stored since a relocalisation that is not verified yet
        self.main_submap = 0  # the submap that is reported
        self._starts_in_map = False  # whether the first keyframes are those of an earlier run

    def state(self) -> State:
        """All keyframes. The last one is stored as its number, or as its own state if it was culled."""
        last = self.last_keyframe
        return {
            "keyframes": [keyframe.state() for keyframe in self.keyframes],
            "last_keyframe": None if last is None else last.host if self.is_stored(last) else last.state(),
            "unverified_from": -1 if self.unverified_from is None else self.unverified_from,
            "main_submap": self.main_submap,
            "starts_in_map": self._starts_in_map,
        }

    def restore(self, state: State, revive: Revive) -> None:
        """Takes over `state`. `revive` makes the keyframes with their images."""
        for kept in state["keyframes"]:
            self.keyframes.append(revive(kept))
            self.keyframes[-1].keep_in(self.swap, self.keyframes[-1].host)
        last = state["last_keyframe"]
        self.last_keyframe = self.keyframes[last] if isinstance(last, int) else last and revive(last)
        self.unverified_from = None if state["unverified_from"] < 0 else state["unverified_from"]
        self.main_submap, self._starts_in_map = state["main_submap"], state["starts_in_map"]

    # New keyframes

    def insert(self, keyframe: Keyframe) -> bool:
        """Stores a selected frame and connects it to the covisible keyframes; returns False if it was culled instead.

        In both cases it becomes the last keyframe.
        """
        scores, measured = covisibilities(keyframe, self.keyframes), self._measured()
        covisible = torch.nonzero(scores > self.config.covisible).flatten().tolist()
        keyframe.covisible.update(covisible)
        keyframe.edges = {i for i in covisible if i in measured}
        if self.last_keyframe is not None:
            keyframe.edges.add(self.last_keyframe.host)
        keyframe.unverified = sorted(keyframe.covisible - keyframe.edges, key=lambda i: -float(scores[i]))
        keyframe.covisible_references = torch.nonzero(scores > self.config.shared).flatten().tolist()
        self.last_keyframe = keyframe
        covering = self._covering(keyframe, scores)
        keyframe.host = len(self.keyframes) if covering is None else covering
        keyframe.submap = min((self.keyframes[i].submap for i in keyframe.edges), default=keyframe.host)
        if covering is None:
            self._store(keyframe)
        return covering is None

    def load(self, keyframe: Keyframe) -> None:
        """Stores a keyframe of an earlier run, before the first frame of this one. All its covisible keyframes count as measured edges."""
        scores = covisibilities(keyframe, self.keyframes)
        self._starts_in_map = True
        keyframe.host = len(self.keyframes)
        keyframe.covisible.update(torch.nonzero(scores > self.config.covisible).flatten().tolist())
        keyframe.edges = set(keyframe.covisible) | ({keyframe.host - 1} if self.keyframes else set())
        keyframe.covisible_references = torch.nonzero(scores > self.config.shared).flatten().tolist()
        self._store(keyframe)
        self.last_keyframe = keyframe

    def _store(self, keyframe: Keyframe) -> None:
        self.keyframes.append(keyframe)
        keyframe.keep_in(self.swap, keyframe.host)
        for i in keyframe.covisible:
            self.keyframes[i].covisible.add(keyframe.host)
        for i in keyframe.edges:
            self.keyframes[i].edges.add(keyframe.host)

    def connect_like_last(self, view: Keyframe) -> None:
        """Gives a frame that is no keyframe the covisible keyframes of the last keyframe."""
        assert self.last_keyframe is not None
        view.covisible = set(self.last_keyframe.covisible)

    def _covering(self, keyframe: Keyframe, scores: Tensor) -> int | None:
        """The stored keyframe with an edge that makes a new one redundant: it is covisible and near. None if there is none."""
        near = self.config.cull_reach * float(keyframe.depth[keyframe.depth > 0].median())
        covering = [i for i in keyframe.edges if float(scores[i]) > self.config.cull and i >= (self.unverified_from or 0)]
        if self.config.cull_reach:
            covering = [i for i in covering if float((self.keyframes[i].T_wk - keyframe.T_wk)[:3, 3].norm()) < near]
        covering = [i for i in covering if unmasked_covisibility(keyframe, self.keyframes[i]) > self.config.cull]
        return max(covering, key=lambda i: float(scores[i]), default=None)

    def is_stored(self, keyframe: Keyframe) -> bool:
        """Whether a keyframe is stored: neither culled, nor a frame that was not selected."""
        return keyframe.host < len(self.keyframes) and self.keyframes[keyframe.host] is keyframe

    # Edges

    def _measured(self) -> Collection[int]:
        """Stored keyframes whose pose relative to the last keyframe counts as measured: those at a short path of edges."""
        if not self.verify or self.last_keyframe is None:
            return range(len(self.keyframes))
        return self._near(self.last_keyframe, path_lengths(self.keyframes, self.last_keyframe.host))

    def _near(self, keyframe: Keyframe, lengths: NDArray[np.float64]) -> set[int]:
        """Stored keyframes at a short path of edges from a keyframe. lengths (K,) [m]: of the paths from its host."""
        return {keyframe.host, *keyframe.edges, *np.flatnonzero(lengths <= self.config.edge_length).tolist()}

    def beyond(self, keyframe: Keyframe, lengths: NDArray[np.float64]) -> list[int]:
        """Stored keyframes without a short path of edges to a keyframe. lengths (K,) [m]: of the paths from its host."""
        near = self._near(keyframe, lengths)
        return [i for i in range(len(self.keyframes)) if i not in near]

    def add_edge(self, keyframe: Keyframe, i: int) -> None:
        """Adds an edge from a keyframe to stored keyframe `i`, whose relative pose was measured. The older one becomes a reference."""
        keyframe.edges.add(i)
        if i < keyframe.host and i not in keyframe.covisible_references:
            bisect.insort(keyframe.covisible_references, i)
        if self.is_stored(keyframe):
            self.keyframes[i].edges.add(keyframe.host)

    # Poses

    def relative_to_host(self, T_wc: Tensor) -> tuple[int, Tensor]:
        """The host of the last keyframe, and a pose (4, 4) relative to it. Before the first keyframe: 0 and the pose itself."""
        host = self.last_keyframe.host if self.last_keyframe else 0
        return host, se3.inverse(self.keyframes[host].T_wk) @ T_wc if self.keyframes else T_wc

    def set_pose(self, keyframe: Keyframe, T_wk: Tensor) -> None:
        """Moves one keyframe, stored or not, to a refined pose (4, 4)."""
        keyframe.T_wk = T_wk

    def move(self, poses: Sequence[Tensor]) -> list[float]:
        """Moves all stored keyframes to poses T_wk (4, 4), and everything attached to them.

        Returns the `shift_ahead` [m] of each.
        """
        changes = []
        last = self.last_keyframe
        if last is not None and not self.is_stored(last):
            last.T_wk = poses[last.host] @ self.relative_to_host(last.T_wk)[1]
        for keyframe, T_wk in zip(self.keyframes, poses, strict=True):
            T = se3.inverse(keyframe.T_wk) @ T_wk
            changes.append(shift_ahead(T))
            keyframe.T_wk = T_wk
        return changes

    # Relocalisation and submaps

    def attach(self, view: Keyframe, keyframe: Keyframe) -> None:
        """Attaches a relocalised view to a stored keyframe, which becomes the last keyframe. The place is not verified yet."""
        self.last_keyframe = keyframe
        view.host = keyframe.host
        self.unverified_from = len(self.keyframes)

    def confirm(self) -> None:
        """Confirms the last relocalisation."""
        self.unverified_from = None

    @property
    def awaits_first_unverified(self) -> bool:
        """Whether no keyframe was stored since a relocalisation that is not verified yet."""
        return self.unverified_from == len(self.keyframes)

    def start_submap(self) -> Tensor:
        """Starts a submap with the next keyframe, without connections to the stored ones; returns a pose T_wc (4, 4) for it."""
        self.last_keyframe = self.unverified_from = None
        return separate_origin(self.keyframes)

    @property
    def starts_submap(self) -> bool:
        """Whether the next keyframe starts a submap."""
        return self.last_keyframe is None

    def choose_main_submap(self) -> None:
        """Makes the submap with the most keyframes the main one, of several the first; a run that starts in a map keeps that of the map."""
        sizes = Counter(keyframe.submap for keyframe in self.keyframes)
        if not self._starts_in_map:
            self.main_submap = min(sizes, key=lambda submap: (-sizes[submap], submap), default=0)

    def merge_submaps(self, a: int, b: int, T_ab: Tensor) -> list[float]:
        """Merges the submaps of keyframes a and b by a measured T_ab (4, 4); returns how far [m] each keyframe moved."""
        submaps = self.keyframes[a].submap, self.keyframes[b].submap
        moved = self.move(merged_poses(self.keyframes, a, b, T_ab))
        for keyframe in self._with_last(self.keyframes):
            if keyframe.submap == max(submaps):
                keyframe.submap = min(submaps)
        self.add_edge(self.keyframes[b], a)
        self.unverified_from = None  # an earlier relocalisation does not bear on the pose between the submaps
        return moved

    def split_off(self) -> list[Keyframe]:
        """Splits off the keyframes stored since a wrong relocalisation as a submap; returns the old ones that seemed covisible."""
        first, self.unverified_from = self.unverified_from, None
        assert first is not None
        old, new = self.keyframes[:first], self.keyframes[first:]
        seemingly_covisible = sorted({i for keyframe in new for i in keyframe.covisible if i < first})
        for keyframe in old:
            keyframe.covisible, keyframe.edges = ({i for i in ids if i < first} for ids in (keyframe.covisible, keyframe.edges))
        for keyframe in self._with_last(new):
            keyframe.covisible, keyframe.edges = ({i for i in ids if i >= first} for ids in (keyframe.covisible, keyframe.edges))
            keyframe.unverified = [i for i in keyframe.unverified if i >= first]
            keyframe.covisible_references = [i for i in keyframe.covisible_references if i >= first]
            keyframe.submap = first
        change = separate_origin(self.keyframes) @ se3.inverse(new[0].T_wk)
        self.move([*(k.T_wk for k in old), *(se3.orthonormal(change @ k.T_wk) for k in new)])
        return [self.keyframes[i] for i in seemingly_covisible]

    def _with_last(self, keyframes: Sequence[Keyframe]) -> list[Keyframe]:
        """Keyframes together with the last one, which may be culled."""
        return [*keyframes] if self.last_keyframe is None else [*keyframes, self.last_keyframe]

    # References

    def lacks_colour(self, view: Keyframe) -> bool:
        """Whether a view's colour image shows nothing new, and that of the last keyframe something: with depth alone all are black."""
        last = self.last_keyframe
        return view.colour_is_older or (view.is_clipped and last is not None and not last.is_clipped)

    def references(self, count: int) -> list[Keyframe]:
        """Up to `count` references for the next frame: the last keyframe and its oldest covisible references."""
        return [] if self.last_keyframe is None else self.references_for(self.last_keyframe, count)[:count]

    def references_for(self, keyframe: Keyframe, count: int) -> list[Keyframe]:
        """Up to `count` references for a view near a stored keyframe: that keyframe and its `older_references`."""
        return [keyframe, *self.older_references(keyframe, count - 1)]

    def older_references(self, keyframe: Keyframe, count: int) -> list[Keyframe]:
        """Up to `count` older keyframes that see most of what a keyframe sees, the oldest first: they have drifted least."""
        return [self.keyframes[i] for i in keyframe.covisible_references if i in keyframe.edges][:count]

    def tracking_references(self, frame: Keyframe) -> list[Keyframe]:
        """The keyframes to register a frame against, in order, chosen by `KeyframeConfig.reference`; later ones are for a frame still lost.

        "covisible" tries the keyframe with the largest mutual covisibility at the predicted pose first, then the last keyframe.
        """
        if self.last_keyframe is None:
            return []
        if self.config.reference == "last" or not frame.has_depth:
            return [self.last_keyframe]
        most = covisibilities(frame, self.keyframes).topk(min(_CANDIDATES, len(self.keyframes))).indices.sort().values.tolist()
        candidates = [self.last_keyframe, *(self.keyframes[i] for i in most)]
        best = max(candidates, key=lambda k: mutual_covisibility(frame, k))
        return [best] if best is self.last_keyframe else [best, self.last_keyframe]
