"""Frames between keyframes: at the end of a run each is resected from what it shows of the keyframes around it, at their adjusted poses.

A frame's alignment reads depth where the sensor reaches, and the brightness of a few hundred pixels. Corners of the last keyframe, which
are looked for in each frame while the camera moves, tell its pose more exactly. Those without depth tell it too, once the last adjustment
knows where they lie. Where little but these holds a pose, the corners of the next keyframe are looked for as well, backwards from it.
"""

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.adjustment.bundle_adjustment import KINDS, Adjusted
from idfslam.adjustment.joint_resection import Images, jointly_resected, on_rays
from idfslam.adjustment.observations import Array, Observations
from idfslam.alignment.alignment import expected_error
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.keyframe_adjustment.global_adjustment import KeyframeAdjustment
from idfslam.slam.keyframe_adjustment.keyframe_corners import SCARCE, HostCorners, KeyframeCorners, shows
from idfslam.slam.tracked import Tracked
from idfslam.storage.state import State, Stateful
from idfslam.tracking.frame_features import brightness

# All of these were chosen by hand on generated rooms and on rooms larger than a Kinect's reach.
_ROUNDED = 1e-3  # [1] added to variances: twice what a number of 16 bits is rounded by. More: long patches count as less long
_TOGETHER = 30  # most frames that are resected together. More: corners are placed more exactly, slower
_MOST_WAITING = 60  # frames that wait for the next keyframe, at a byte a pixel. More: longer stretches gain, and take more memory


class Resection(Stateful, ABC):
    """Improves the poses of frames between keyframes at the end of a run."""

    @abstractmethod
    def see(self, view: Keyframe, tracked: Tracked) -> None:
        """Called with each frame, once it has its place among frames and keyframes."""

    @abstractmethod
    def run(self) -> None:
        """Called once, when the keyframes' poses are final."""


class NoResection(Resection):
    """Frames stay where they were tracked, relative to keyframes."""

    def see(self, view: Keyframe, tracked: Tracked) -> None: ...

    def run(self) -> None: ...


@dataclass(frozen=True)
class _Sightings:
    """N corners of a host that a frame shows."""

    frame: int
    host: int  # number among the hosts
    corner: Tensor  # (N,) int16
    uv: Tensor  # (N, 2) float32 [px]
    rounded: Tensor  # (N, 2, 2) float16 [1/px^2] information

    @property
    def information(self) -> Array:
        """(N, 2, 2) [1/px^2], positive definite in spite of the rounding."""
        return np.asarray(self.rounded.double().numpy() * (1 + _ROUNDED * np.eye(2)))


class FrameResection(Resection):
    """Looks for keyframes' corners in frames, and resects these at the end if the keyframes were adjusted.

    Only where all rows of an image are of one moment: what bends a frame would be taken for a motion.
    """

    def __init__(
        self,
        graph: KeyframeGraph,
        frames: FramePoses,
        corners: KeyframeCorners,
        adjustment: KeyframeAdjustment,
        agree: Callable[[], bool] = lambda: True,
    ) -> None:
        """agree: whether the images of the last keyframes do. Where they do not, only frames with scarce depth are looked at."""
        self.graph, self.frames, self.corners, self.adjustment, self.agree = graph, frames, corners, adjustment, agree
        self._seen: list[_Sightings] = []
        self._covariances: dict[int, Tensor] = {}  # (6, 6) by frame, of shift [m] and turn [rad] along the camera's axes
        self._waiting: list[tuple[int, Tensor]] = []  # frames that the next keyframe's corners are looked for in: index, grey (H, W)

    def state(self) -> State:
        """Sightings, covariances, and the brightness of the frames that wait."""
        return {
            "seen": [vars(seen) | {} for seen in self._seen],
            "frames": list(self._covariances),
            "covariances": torch.stack(list(self._covariances.values())) if self._covariances else torch.zeros(0, 6, 6),
            "waiting": [{"frame": frame, "grey": grey} for frame, grey in self._waiting],
        }

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._seen = [_Sightings(**seen) for seen in state["seen"]]
        self._covariances = dict(zip(state["frames"], (C.clone() for C in state["covariances"])))
        self._waiting = [(waiting["frame"], waiting["grey"]) for waiting in state["waiting"]]

    def see(self, view: Keyframe, tracked: Tracked) -> None:
        if not self.graph.keyframes or view.rectification is not None:
            return
        if self.graph.is_stored(view):
            self._seen = [seen for seen in self._seen if seen.frame != len(self.frames) - 1]  # a keyframe keeps its pose
            self._look_back(view.host)
        elif tracked.covariance is not None and not tracked.is_lost and not view.colour_is_older:
            aligned = tracked.alignment
            without_corners = tracked.covariance if aligned is None or aligned.covariance is None else aligned.covariance
            self._look_forward(view, without_corners)

    def _look_forward(self, view: Keyframe, covariance: Tensor) -> None:
        """Looks for the last keyframe's corners in a frame."""
        scarce = expected_error(covariance)[0] > SCARCE
        if not (scarce or self.agree()):
            return
        frame, (number, _) = len(self.frames) - 1, self.frames.in_host(-1)
        self.corners.begin(number)
        grey, R = torch.from_numpy(brightness(view.frame)), torch.block_diag(*[self.frames.T_wc(-1)[:3, :3]] * 2)
        self._covariances[frame] = (R.T @ covariance @ R).float()
        self._look(frame, grey, view.moving)
        if scarce:
            self._waiting = [*self._waiting[1 - _MOST_WAITING :], (frame, grey)]

    def _look_back(self, number: int) -> None:
        """Looks for the corners of a new keyframe in the frames before it that wait."""
        self.corners.begin(number)
        for frame, grey in reversed(self._waiting):
            if self.frames.submap(frame) == self.graph.keyframes[number].submap:
                self._look(frame, grey, None)
        self._waiting = []

    def _look(self, frame: int, grey: Tensor, moving: NDArray[np.bool_] | None) -> None:
        """Looks for the corners of the last host in a frame's image (H, W)."""
        T_wc = self.frames.T_wc(frame)
        seen = self.corners.narrow(self.corners.search(grey, T_wc, moving), T_wc)
        if len(seen.corner):
            arrays = seen.corner.astype(np.int16), seen.uv.astype(np.float32), np.linalg.inv(seen.covariance).astype(np.float16)
            self._seen.append(_Sightings(frame, seen.host, *(torch.from_numpy(array) for array in arrays)))

    def run(self) -> None:
        adjusted = self.adjustment.adjusted
        if adjusted is None or adjusted.problem.velocities is not None:
            return
        by_frame, by_host = dict[int, list[_Sightings]](), [list[_Sightings]() for _ in self.corners.hosts]
        for seen in self._seen:
            by_host[seen.host].append(seen)
            by_frame.setdefault(seen.frame, []).append(seen)
        places = [self._places(host, seen_of, adjusted) for host, seen_of in zip(self.corners.hosts, by_host)]
        groups = list(_groups(by_frame.values()))
        for group, poses in zip(groups, jointly_resected([self._images(group, places, adjusted) for group in groups])):
            for parts, T_wc in zip(group, poses):
                self.frames.move(parts[0].frame, torch.from_numpy(T_wc))

    def _places(self, host: HostCorners, seen: Sequence[_Sightings], adjusted: Adjusted) -> tuple[Array, Array]:
        """Of a host's corners: (M, 3) [m] in the world, NaN where nothing is known, and (M, 3, 3) [m^2] their covariances."""
        keyframe, problem = self.graph.keyframes[host.keyframe], adjusted.problem
        T, (z, z_sigma) = keyframe.T_wk.numpy(), host.depth(adjusted.noise[KINDS.index("depth")])
        variance = self._noise(adjusted)[host.kind][:, None, None] ** 2
        points, covariances = on_rays(problem.model, host.uv, z, _mean_covariances(len(host), seen) * variance, z_sigma)
        points, covariances = points @ T[:3, :3].T + T[:3, 3], T[:3, :3] @ covariances @ T[:3, :3].T
        of_host = problem.seen.keyframe == host.keyframe
        known = {tuple(uv): landmark for uv, landmark in zip(problem.seen.uv[of_host].tolist(), problem.seen.landmark[of_host].tolist())}
        for i, uv in enumerate(host.uv.tolist()):
            if (landmark := known.get(tuple(uv))) is not None:
                points[i], covariances[i] = problem.points[landmark], adjusted.system.landmark_covariances[landmark]
        if keyframe.moving is not None:
            points[shows(keyframe.moving, host.uv, problem.model.camera)] = np.nan
        return points, covariances

    @staticmethod
    def _noise(adjusted: Adjusted) -> Array:
        """(2,) [1] of places in images, of corners with depth and of those without, as the adjustment has found it."""
        return np.array([adjusted.noise[KINDS.index(kind)] for kind in ("image", "distant")])

    def _images(self, group: Sequence[Sequence[_Sightings]], places: Sequence[tuple[Array, Array]], adjusted: Adjusted) -> Images:
        """Frames, each with what it shows, and the corners that they show."""
        frames, hosts = [parts[0].frame for parts in group], sorted({seen.host for parts in group for seen in parts})
        first = dict(zip(hosts, np.cumsum([0, *(len(self.corners.hosts[host]) for host in hosts)])))
        points, covariances = (np.concatenate([places[host][i] for host in hosts]) for i in range(2))
        noise, kind = self._noise(adjusted), np.concatenate([self.corners.hosts[host].kind for host in hosts])
        parts = [(i, seen) for i, of_frame in enumerate(group) for seen in of_frame]
        landmark = np.concatenate([seen.corner.numpy() + first[seen.host] for _, seen in parts])
        uv = np.concatenate([seen.uv.double().numpy() for _, seen in parts])
        information = np.concatenate([seen.information for _, seen in parts])
        image = np.concatenate([np.full(len(seen.corner), i) for i, seen in parts])
        root = np.linalg.cholesky(information).transpose(0, 2, 1) / noise[kind[landmark], None, None]
        n = len(image)
        seen = Observations(image, landmark, uv, root, np.zeros(n), np.ones(n), np.zeros((n, 2)))[~np.isnan(points[landmark, 0])]
        shown, number = np.unique(seen.landmark, return_inverse=True)
        poses, of_poses = np.stack([self.frames.T_wc(frame).numpy() for frame in frames]), [self._covariances[frame] for frame in frames]
        seen = replace(seen, landmark=number)[np.lexsort((seen.keyframe, number))]
        return Images(adjusted.problem.model, poses, torch.stack(of_poses).double().numpy(), points[shown], covariances[shown], seen)


def _mean_covariances(count: int, sightings: Sequence[_Sightings]) -> Array:
    """(M, 2, 2) [px^2] of `count` corners' places in their keyframe: as exactly as it shows them, frames show them on average."""
    total, seen = np.zeros((count, 2, 2)), np.zeros(count)
    for part in sightings:
        corner = part.corner.numpy()
        total[corner] += np.linalg.inv(part.information)
        seen[corner] += 1
    return total / np.maximum(seen, 1)[:, None, None]


def _groups(sightings: Iterable[list[_Sightings]]) -> Iterator[list[list[_Sightings]]]:
    """What each frame shows, frames together that show corners of the same host first."""
    for _, of_host in itertools.groupby(sightings, key=lambda parts: parts[0].host):
        parts = list(of_host)
        yield from (parts[i : i + _TOGETHER] for i in range(0, len(parts), _TOGETHER))
