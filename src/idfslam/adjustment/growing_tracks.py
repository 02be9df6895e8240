"""Landmarks of a recording that still runs: each new keyframe is searched for those of earlier keyframes, and hosts new ones.

Nothing is moved: a landmark lies where its host saw it, and what was found stays, unless it turns out to move. So poses may change at any
time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.distant_corners import DistantCorners, open_pixels
from idfslam.adjustment.distant_landmarks import searched
from idfslam.adjustment.landmark_tracks import KeyframeView, Taken, found_in
from idfslam.adjustment.local_depth import local_depth
from idfslam.adjustment.observations import Array, Indices, Observations, determined, joined
from idfslam.adjustment.patch_search import root_of
from idfslam.storage.state import State, Stateful
from idfslam.tracking.frame_features import FrameFeatures
from idfslam.tracking.patches import Patches

# Keyframes besides its host that must see a corner without depth for it to be a landmark. More: fewer and surer ones, later. Chosen by
# hand on rooms larger than a Kinect's reach
_VIEWERS = 2


@dataclass
class _Hosted:
    """M corners of a keyframe, those with depth and then those without: its landmarks, and its own sightings of them."""

    near: Patches
    distant: DistantCorners
    reading: Array  # (M,) [m]
    sigma: Array  # (M,) [m]
    slope: Array  # (M, 2) [m/px]
    first: int  # number of its first landmark
    covariance: Array  # (M, 2, 2) [px^2] sum of those of the positions where others see them
    sightings: Indices  # (M,) how many of these there are

    def state(self) -> State:
        """All of it."""
        arrays = {name: torch.from_numpy(vars(self)[name].copy()) for name in _ARRAYS}
        return {"near": vars(self.near) | {}, "distant": self.distant.state(), "first": self.first, **arrays}

    @staticmethod
    def from_state(state: State) -> "_Hosted":
        """What `state` was made of."""
        corners = Patches(**state["near"]), DistantCorners.from_state(state["distant"])
        return _Hosted(*corners, first=state["first"], **{name: state[name].numpy().copy() for name in _ARRAYS})

    def __len__(self) -> int:
        return len(self.near) + len(self.distant)

    @property
    def uv(self) -> Array:
        """(M, 2) [px]"""
        return np.concatenate([self.near.uv.numpy(), self.distant.uv])

    @property
    def points(self) -> Array:
        """(M, 3) [m] in the keyframe's frame, as it saw them alone."""
        return np.concatenate([self.near.points.numpy(), self.distant.at(0.5).points.numpy()])

    @property
    def are_known(self) -> NDArray[np.bool_]:
        """(M,) whether it is known how far away they are."""
        of_distant = self.distant.are_known & (self.sightings[len(self.near) :] >= _VIEWERS)
        return np.concatenate([np.ones(len(self.near), bool), of_distant])

    def kept(self, chosen: Indices, first: int) -> "_Hosted":
        """Some of them (ascending), numbered from `first` on."""
        near = chosen < len(self.near)
        corners = self.near[torch.from_numpy(chosen[near])], self.distant[chosen[~near] - len(self.near)]
        return _Hosted(*corners, first=first, **{name: vars(self)[name][chosen] for name in _ARRAYS})

    def found_by(self, host: FrameFeatures, viewer: FrameFeatures, T_vh: Array, model: CameraModel) -> tuple[Indices, Array, Array]:
        """Which of the host's corners (M,) a viewer at T_vh (4, 4) shows, where, uv (M, 2), and the covariance (M, 2, 2) of that."""
        found = found_in(self.near, host, viewer, T_vh, model)
        if not len(self.distant):
            return found
        seen, uv, covariance = searched(self.distant, host, viewer, T_vh, model)
        at = np.flatnonzero(self.distant.narrow(seen, uv, T_vh, model))
        parts = (at + len(self.near), uv[at], covariance[at])
        return tuple(np.concatenate(pair) for pair in zip(found, parts))  # type: ignore[return-value]


_ARRAYS = "reading", "sigma", "slope", "covariance", "sightings"


class GrowingTracks(Stateful):
    """Landmarks, numbered in the order in which they were hosted, and where keyframes see them."""

    def __init__(self) -> None:
        self._hosted: dict[int, _Hosted] = {}
        self._seen: dict[int, Observations] = {}  # what each keyframe sees of the landmarks of others
        self._viewers: dict[int, list[int]] = {}  # the keyframes that a host's landmarks were looked for in
        self._count = 0

    def state(self) -> State:
        """The landmarks and their sightings."""
        seen = {str(k): {name: torch.from_numpy(array.copy()) for name, array in s.columns.items()} for k, s in self._seen.items()}
        return {"hosted": {str(k): hosted.state() for k, hosted in self._hosted.items()}, "seen": seen, "count": self._count} | {
            "viewers": {str(k): viewers for k, viewers in self._viewers.items()}
        }

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._hosted = {int(k): _Hosted.from_state(hosted) for k, hosted in state["hosted"].items()}
        self._seen = {int(k): Observations(**{name: t.numpy().copy() for name, t in s.items()}) for k, s in state["seen"].items()}
        self._viewers = {int(k): list(viewers) for k, viewers in state["viewers"].items()}
        self._count = state["count"]

    def add(
        self,
        number: int,
        features: FrameFeatures,
        view: KeyframeView,
        others: Sequence[tuple[int, FrameFeatures, Array]],
        model: CameraModel,
    ) -> None:
        """Adds keyframe `number`.

        others: keyframes whose landmarks it may see: number, features, and its pose T_ok (4, 4) in theirs, right to about five pixels.
        """
        taken, found, no_reading = Taken(tuple(features.grey.shape)), [], open_pixels(view)
        for k, other, T_ok in others:
            if (hosted := self._hosted.get(k)) is None or not len(hosted):
                continue
            at, uv, covariance = hosted.found_by(other, features, np.asarray(np.linalg.inv(T_ok), np.float64), model)
            reading, sigma, slope = local_depth(view.depth, uv)
            good = ((reading > 0) | ((at >= len(hosted.near)) & _at(no_reading, uv))) & taken.free(uv)
            at, (uv, covariance, reading, sigma, slope) = at[good], (column[good] for column in (uv, covariance, reading, sigma, slope))
            taken.take(uv)
            hosted.covariance[at] += covariance
            hosted.sightings[at] += 1
            self._viewers.setdefault(k, []).append(number)
            numbers = np.full(len(at), number, np.int64), hosted.first + at
            found.append(Observations(*numbers, uv, root_of(covariance), reading, sigma, slope))
        self._seen[number] = joined(found)
        self._host(number, features, view, taken, model)

    def _host(self, number: int, features: FrameFeatures, view: KeyframeView, taken: Taken, model: CameraModel) -> None:
        patches, distant = features.patches, DistantCorners.of(view, model)
        reading, sigma, slope = local_depth(view.depth, patches.uv.numpy())
        chosen = (reading > 0) & taken.free(patches.uv.numpy())
        patches, distant = patches[torch.from_numpy(np.flatnonzero(chosen))], distant[taken.free(distant.uv)]
        none, count = len(distant), len(patches) + len(distant)
        reading, sigma = np.append(reading[chosen], np.zeros(none)), np.append(sigma[chosen], np.ones(none))
        slope = np.concatenate([slope[chosen], np.zeros((none, 2))])
        self._hosted[number] = _Hosted(
            patches, distant, reading, sigma, slope, self._count, np.zeros((count, 2, 2)), np.zeros(count, np.int64)
        )
        self._count += count

    def forget(self, k: int) -> None:
        """Forgets what a keyframe hosts and sees."""
        if (hosted := self._hosted.pop(k, None)) is not None:
            for viewer in self._viewers.pop(k, []):
                self._drop(viewer, hosted)
        self._seen.pop(k, None)
        self._viewers = {host: [viewer for viewer in viewers if viewer != k] for host, viewers in self._viewers.items()}

    def hide(self, k: int, moving: NDArray[np.bool_]) -> None:
        """Forgets what a keyframe hosts and sees where its `grey` image (H, W) shows what moves. What it hosts is numbered anew."""
        if (hosted := self._hosted.get(k)) is None:
            return
        self._seen[k] = self._seen[k][~_at(moving, self._seen[k].uv)]
        kept = np.flatnonzero(~_at(moving, hosted.uv))
        self._hosted[k] = hosted.kept(kept, self._count)
        for viewer in self._viewers.get(k, []):
            seen = self._seen[viewer]
            place = seen.landmark - hosted.first
            of_host = (place >= 0) & (place < len(hosted))
            numbers = np.where(of_host, self._count + np.searchsorted(kept, place), seen.landmark)
            self._seen[viewer] = replace(seen, landmark=numbers)[~of_host | np.isin(place, kept)]
        self._count += len(kept)

    def separate(self, group: Sequence[int]) -> None:
        """Forgets what keyframes see of landmarks of other groups, whose number `group` has for each keyframe."""
        for host, viewers in self._viewers.items():
            for viewer in [viewer for viewer in viewers if group[viewer] != group[host]]:
                self._drop(viewer, self._hosted[host])
                viewers.remove(viewer)

    def _drop(self, viewer: int, hosted: _Hosted) -> None:
        seen = self._seen[viewer]
        place = seen.landmark - hosted.first
        self._seen[viewer] = seen[(place < 0) | (place >= len(hosted))]

    def seen_by(self, chosen: NDArray[np.bool_], poses: Array) -> tuple[Array, Observations]:
        """Landmarks (L, 3) [m] in the world that any of the keyframes `chosen` (K,) sees, and all sightings of these.

        poses: (K, 4, 4) T_wk, by the keyframes' numbers.
        """
        hosts = sorted({k for k in self._hosted if chosen[k]} | {host for host, viewers in self._viewers.items() if chosen[viewers].any()})
        viewers = sorted({viewer for host in hosts for viewer in self._viewers.get(host, [])})
        everything = joined([*(self._seen[k] for k in viewers), *(self._own(k) for k in hosts)])
        known = np.concatenate(
            [self._hosted[k].first + np.flatnonzero(self._hosted[k].are_known) for k in hosts] or [np.zeros(0, np.int64)]
        )
        wanted = np.intersect1d(everything.landmark[chosen[everything.keyframe]], known)
        seen = everything[np.isin(everything.landmark, wanted)]
        seen = seen[np.lexsort((seen.keyframe, seen.landmark))]
        numbers = np.searchsorted(wanted, seen.landmark)
        return determined(self._points(wanted, hosts, poses), replace(seen, landmark=numbers))

    def _own(self, k: int) -> Observations:
        """The sightings of a host's landmarks by itself, of those that another one sees."""
        hosted = self._hosted[k]
        at = np.flatnonzero(hosted.sightings)
        root = root_of(hosted.covariance[at] / hosted.sightings[at, None, None])
        measured = hosted.reading[at], hosted.sigma[at], hosted.slope[at]
        return Observations(np.full(len(at), k, np.int64), hosted.first + at, hosted.uv[at], root, *measured)

    def _points(self, landmarks: Indices, hosts: Sequence[int], poses: Array) -> Array:
        """(L, 3) [m] in the world of landmarks (L,), ascending, of these hosts."""
        points = np.zeros((len(landmarks), 3))
        for k in hosts:
            hosted, T = self._hosted[k], poses[k]
            first, end = np.searchsorted(landmarks, [hosted.first, hosted.first + len(hosted)])
            p = hosted.points[landmarks[first:end] - hosted.first]
            points[first:end] = p @ T[:3, :3].T + T[:3, 3]
        return points


def _at(pixels: NDArray[np.bool_], uv: Array) -> NDArray[np.bool_]:
    """(N,) the pixels (H, W) nearest to uv (N, 2)."""
    u, v = np.rint(uv).astype(np.int64).T
    return np.asarray(pixels[v.clip(0, pixels.shape[0] - 1), u.clip(0, pixels.shape[1] - 1)])
