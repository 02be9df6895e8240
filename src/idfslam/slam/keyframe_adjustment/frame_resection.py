"""Frames between keyframes: at the end of a run each is resected from what it shows of the keyframes around it, at their adjusted poses.

A frame's alignment reads depth where the sensor reaches, and the brightness of a few hundred pixels. Corners of the last keyframe, which
are looked for in each frame while the camera moves, tell its pose more exactly. Those without depth tell it too, once the last adjustment
knows where they lie. Where little but these holds a pose, the corners of the next keyframe are looked for as well, backwards from it.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.adjustment.bundle_adjustment import KINDS, Adjusted
from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.distant_corners import DistantCorners
from idfslam.adjustment.landmark_tracks import KeyframeView
from idfslam.adjustment.local_depth import local_depth
from idfslam.adjustment.patch_search import search
from idfslam.adjustment.resection import resected
from idfslam.alignment.alignment import expected_error
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.keyframe_adjustment.global_adjustment import KeyframeAdjustment
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.slam.tracked import Tracked
from idfslam.storage.state import State, Stateful
from idfslam.tracking.frame_features import brightness
from idfslam.tracking.patch_alignment import AlignedPatches
from idfslam.tracking.patches import Patches

# All of these were chosen by hand on generated rooms and on rooms larger than a Kinect's reach.
_MOST_PATCHES = 200  # patches with depth of a keyframe that frames are searched for. More: exacter poses, more time and memory
# [m] Expected error of a pose from which the next keyframe's corners are looked for too. More: fewer such frames, and these gain less
_SCARCE = 0.005
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


@dataclass
class _Host:
    """The corners of a keyframe that frames are searched for: those with depth, then those without."""

    keyframe: int  # number of the stored keyframe
    near: Patches
    distant: DistantCorners

    @property
    def uv(self) -> NDArray[np.float64]:
        """(M, 2) [px]"""
        return np.concatenate([self.near.uv.numpy(), self.distant.uv])

    def state(self) -> State:
        """All of it."""
        near, distant = (vars(part) for part in (self.near, self.distant))
        return {"keyframe": self.keyframe, "near": near | {}, "distant": {name: torch.from_numpy(a.copy()) for name, a in distant.items()}}

    @staticmethod
    def from_state(state: State) -> "_Host":
        """What `state` was made of."""
        distant = {name: tensor.numpy().copy() for name, tensor in state["distant"].items()}
        return _Host(state["keyframe"], Patches(**state["near"]), DistantCorners(**distant))


@dataclass(frozen=True)
class _Sightings:
    """N corners of a host that a frame shows."""

    frame: int
    host: int  # number among the hosts
    corner: Tensor  # (N,) int16
    uv: Tensor  # (N, 2) float32 [px]
    information: Tensor  # (N, 2, 2) float16 [1/px^2]


class FrameResection(Resection):
    """Looks for keyframes' corners in frames, and resects these at the end if the keyframes were adjusted.

    Only where all rows of an image are of one moment: what bends a frame would be taken for a motion.
    """

    def __init__(
        self,
        graph: KeyframeGraph,
        frames: FramePoses,
        features: KeyframeFeatures,
        adjustment: KeyframeAdjustment,
        agree: Callable[[], bool] = lambda: True,
    ) -> None:
        """agree: whether the images of the last keyframes do. Where they do not, only frames with scarce depth are looked at."""
        self.graph, self.frames, self.features, self.adjustment, self.agree = graph, frames, features, adjustment, agree
        self._hosts: list[_Host] = []
        self._seen: list[_Sightings] = []
        self._covariances: dict[int, Tensor] = {}  # (6, 6) by frame, of shift [m] and turn [rad] along the camera's axes
        self._waiting: list[tuple[int, Tensor]] = []  # frames that the next keyframe's corners are looked for in: index, grey (H, W)

    def state(self) -> State:
        """Corners, sightings, covariances, and the brightness of the frames that wait."""
        return {
            "hosts": [host.state() for host in self._hosts],
            "seen": [vars(seen) | {} for seen in self._seen],
            "frames": list(self._covariances),
            "covariances": torch.stack(list(self._covariances.values())) if self._covariances else torch.zeros(0, 6, 6),
            "waiting": [{"frame": frame, "grey": grey} for frame, grey in self._waiting],
        }

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._hosts = [_Host.from_state(host) for host in state["hosts"]]
        self._seen = [_Sightings(**seen) for seen in state["seen"]]
        self._covariances = dict(zip(state["frames"], (C.clone() for C in state["covariances"])))
        self._waiting = [(waiting["frame"], waiting["grey"]) for waiting in state["waiting"]]

    def see(self, view: Keyframe, tracked: Tracked) -> None:
        if not self.graph.keyframes or view.rectification is not None:
            return
        if self.graph.is_stored(view):
            self._look_back(view.host)
        elif tracked.covariance is not None and not tracked.is_lost and not view.colour_is_older:
            self._look_forward(view, tracked.covariance)

    def _begin(self, number: int) -> None:
        """Begins with the corners of a stored keyframe."""
        keyframe = self.graph.keyframes[number]
        features = self.features.of(keyframe)
        near, view = features.patches, KeyframeView.of(keyframe.frame, keyframe.moving)
        chosen = np.unique(np.linspace(0, max(len(near) - 1, 0), min(len(near), _MOST_PATCHES)).round().astype(np.int64))
        near = near[torch.from_numpy(chosen)]
        reading = torch.from_numpy(local_depth(view.depth, near.uv.numpy())[0])
        points = torch.where((reading > 0)[:, None], near.points * (reading / near.points[:, 2])[:, None], near.points)
        distant = DistantCorners.of(view, CameraModel.as_stated(features.grey_camera))
        self._hosts.append(_Host(number, replace(near, points=points), distant))

    def _look_forward(self, view: Keyframe, covariance: Tensor) -> None:
        """Looks for the last keyframe's corners in a frame."""
        scarce = expected_error(covariance)[0] > _SCARCE
        if not (scarce or self.agree()):
            return
        frame, (number, _) = len(self.frames) - 1, self.frames.in_host(-1)
        if not self._hosts or self._hosts[-1].keyframe != number:
            self._begin(number)
        grey, R = torch.from_numpy(brightness(view.frame)), torch.block_diag(*[self.frames.T_wc(-1)[:3, :3]] * 2)
        self._covariances[frame] = (R.T @ covariance @ R).float()
        self._look(frame, grey, view.moving)
        if scarce:
            self._waiting = [*self._waiting[1 - _MOST_WAITING :], (frame, grey)]

    def _look_back(self, number: int) -> None:
        """Looks for the corners of a new keyframe in the frames before it that wait."""
        if self._waiting:
            self._begin(number)
        for frame, grey in reversed(self._waiting):
            if self.frames.submap(frame) == self.graph.keyframes[number].submap:
                self._look(frame, grey, None)
        self._waiting = []

    def _look(self, frame: int, grey: Tensor, moving: NDArray[np.bool_] | None) -> None:
        """Looks for the corners of the last host in a frame's image (H, W)."""
        host = self._hosts[-1]
        keyframe = self.graph.keyframes[host.keyframe]
        features = self.features.of(keyframe)
        model, T_fk = CameraModel.as_stated(features.grey_camera), (se3.inverse(self.frames.T_wc(frame)) @ keyframe.T_wk).numpy()
        near, distant = (search(patches, features.grey, grey, T_fk, model) for patches in (host.near, host.distant.at(0.5)))
        fits = host.distant.narrow_by(distant, T_fk, model)
        corner = np.concatenate([near.patch, len(host.near) + distant.patch[fits]])
        uv, covariance = (np.concatenate([a, b[fits]]) for a, b in ((near.uv, distant.uv), (near.covariance, distant.covariance)))
        if moving is not None:
            still = ~_shows(moving, uv, features.grey_camera)
            corner, uv, covariance = corner[still], uv[still], covariance[still]
        if len(corner):
            arrays = corner.astype(np.int16), uv.astype(np.float32), np.linalg.inv(covariance).astype(np.float16)
            self._seen.append(_Sightings(frame, len(self._hosts) - 1, *(torch.from_numpy(array) for array in arrays)))

    def run(self) -> None:
        adjusted = self.adjustment.adjusted
        if adjusted is None or adjusted.problem.velocities is not None:
            return
        points = [self._points(host, adjusted) for host in self._hosts]
        by_frame: dict[int, list[_Sightings]] = {}
        for seen in self._seen:
            by_frame.setdefault(seen.frame, []).append(seen)
        for frame, parts in by_frame.items():
            if not self.frames.is_refined(frame):
                T_wc = self.frames.T_wc(frame)
                R = torch.block_diag(*[T_wc[:3, :3]] * 2)
                covariance = R @ self._covariances[frame].double() @ R.T
                self.frames.move(frame, resected(T_wc, covariance, self._measured(parts, points, adjusted)))

    def _points(self, host: _Host, adjusted: Adjusted) -> Tensor:
        """(M, 3) [m] in the world, of a host's corners; NaN where none is known."""
        keyframe, problem = self.graph.keyframes[host.keyframe], adjusted.problem
        points = np.full((len(host.near) + len(host.distant), 3), np.nan)
        points[: len(host.near)] = se3.transform(keyframe.T_wk, host.near.points).numpy()
        of_host = problem.seen.keyframe == host.keyframe
        known = {tuple(uv): landmark for uv, landmark in zip(problem.seen.uv[of_host].tolist(), problem.seen.landmark[of_host].tolist())}
        for i, uv in enumerate(host.uv.tolist()):
            if (landmark := known.get(tuple(uv))) is not None:
                points[i] = problem.points[landmark]
        if keyframe.moving is not None:
            points[_shows(keyframe.moving, host.uv, problem.model.camera)] = np.nan
        return torch.from_numpy(points)

    def _measured(self, parts: Sequence[_Sightings], points: Sequence[Tensor], adjusted: Adjusted) -> AlignedPatches:
        """What a frame shows of points (M, 3) [m] of each host, in the noise that the adjustment has found.

        The keyframe's place of a corner is as noisy as the frame's.
        """
        image, distant = (2 * adjusted.noise[KINDS.index(kind)] ** 2 for kind in ("image", "distant"))
        places = torch.cat([points[part.host][part.corner.long()] for part in parts])
        has_depth = torch.cat([part.corner < len(self._hosts[part.host].near) for part in parts])
        variance = torch.where(has_depth, image, distant)[:, None, None]
        uv, information = torch.cat([part.uv for part in parts]).double(), torch.cat([part.information for part in parts]).double()
        known = ~places[:, 0].isnan()
        nothing = torch.zeros(int(known.sum()), dtype=torch.float64)
        camera = adjusted.problem.model.camera
        return AlignedPatches(places[known], uv[known], (information / variance)[known], nothing, nothing, camera)


def _shows(pixels: NDArray[np.bool_], uv: NDArray[np.float64], camera: Camera) -> NDArray[np.bool_]:
    """(N,) the pixels of an image (H, W) nearest to places uv (N, 2) in one of a camera."""
    rows, columns = pixels.shape
    u, v = np.rint((uv + 0.5) * [columns / camera.width, rows / camera.height] - 0.5).astype(np.int64).T
    return np.asarray(pixels[v.clip(0, rows - 1), u.clip(0, columns - 1)])
