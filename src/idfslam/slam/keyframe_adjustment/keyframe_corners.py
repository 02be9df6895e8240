"""Corners of keyframes that frames are searched for, and how far away each is, as far as that is known.

A corner with depth has a reading's error. Of one without depth nothing is known at first, and each frame that shows it narrows the interval
of its inverse depth (`distant_corners.py`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.distant_corners import DistantCorners
from idfslam.adjustment.landmark_tracks import KeyframeView
from idfslam.adjustment.local_depth import local_depth
from idfslam.adjustment.observations import Array, Indices
from idfslam.adjustment.patch_search import Found, search
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.storage.state import State, Stateful
from idfslam.tracking.patches import Patches

# All of these were chosen by hand on generated rooms and on rooms larger than a Kinect's reach.
# [m] Error that is expected of a frame's pose by its alignment, above which corners are asked while the camera moves, and those of the next
# keyframe too. More: fewer frames gain, and less time is spent
SCARCE = 0.005
_MOST_PATCHES = 120  # patches with depth of a keyframe that frames are searched for. More: exacter poses, more time and memory
_UNEVEN = 0.02  # [1] standard deviation of depth where no smooth surface is, as a share of it. More: edges of things count less
# [1] Least share of the least inverse depth that a corner without depth may have in the largest, to count. More: fewer and surer corners
_LEAST_KNOWN = 0.5
_UNIFORM = 1 / np.sqrt(12)  # [1] standard deviation over width of an interval: a fact of the uniform distribution


@dataclass
class HostCorners:
    """M corners of a keyframe, those with depth and then those without."""

    keyframe: int  # number of the stored keyframe
    near: Patches
    sigma: Array  # (N,) [m] of the depth of those with depth
    distant: DistantCorners

    @classmethod
    def of(cls, number: int, keyframe: Keyframe, features: KeyframeFeatures, uv: Array, depth: Array) -> "HostCorners":
        """Those of a stored keyframe with this number. uv (N, 2) [px], depth (N,) [m]: of those that were adjusted."""
        shown, view = features.images_of(keyframe), KeyframeView.of(keyframe.frame, keyframe.moving)
        near = shown.patches
        chosen = np.unique(np.linspace(0, max(len(near) - 1, 0), min(len(near), _MOST_PATCHES)).round().astype(np.int64))
        near = near[torch.from_numpy(chosen)]
        reading, sigma, _ = local_depth(view.depth, near.uv.numpy())
        read = reading > 0
        points = near.points * torch.from_numpy(np.where(read, reading / near.points[:, 2].numpy(), 1.0))[:, None]
        model = CameraModel.as_stated(shown.grey_camera)
        distant = DistantCorners.of(view, model) + DistantCorners.adjusted(uv, depth, model)
        return cls(number, replace(near, points=points), np.where(read, sigma, _UNEVEN * points[:, 2].numpy()), distant)

    def __len__(self) -> int:
        return len(self.near) + len(self.distant)

    @property
    def kind(self) -> Indices:
        """(M,) 0 of those with depth, 1 of those without."""
        return np.repeat([0, 1], [len(self.near), len(self.distant)])

    @property
    def uv(self) -> Array:
        """(M, 2) [px]"""
        return np.concatenate([self.near.uv.numpy(), self.distant.uv])

    def depth(self, noise: float = 1.0) -> tuple[Array, Array]:
        """(M,) [m] and its standard deviation (M,) [m], where the sensor's noise is so many times the stated one. NaN where it is open."""
        least, most = self.distant.least, self.distant.most
        known = least > _LEAST_KNOWN * most
        z = np.where(known, 2 / np.maximum(least + most, 1e-9), np.nan)
        return np.concatenate([self.near.points[:, 2].numpy(), z]), np.concatenate([noise * self.sigma, z * z * (most - least) * _UNIFORM])

    def state(self) -> State:
        """All of it."""
        near = vars(self.near) | {}
        sigma = torch.from_numpy(self.sigma.copy())
        return {"keyframe": self.keyframe, "near": near, "sigma": sigma, "distant": self.distant.state()}

    @staticmethod
    def from_state(state: State) -> "HostCorners":
        """What `state` was made of."""
        near, distant = Patches(**state["near"]), DistantCorners.from_state(state["distant"])
        return HostCorners(state["keyframe"], near, state["sigma"].numpy().copy(), distant)


@dataclass(frozen=True)
class SeenCorners:
    """N corners of a host that a frame shows."""

    host: int  # number among the hosts
    corner: Indices  # (N,)
    uv: Array  # (N, 2) [px]
    covariance: Array  # (N, 2, 2) [px^2]

    def __getitem__(self, chosen: NDArray[np.bool_]) -> "SeenCorners":
        return SeenCorners(self.host, self.corner[chosen], self.uv[chosen], self.covariance[chosen])


class KeyframeCorners(Stateful):
    """The corners of keyframes, in the order in which frames were searched for them."""

    def __init__(
        self,
        graph: KeyframeGraph,
        features: KeyframeFeatures,
        adjusted: Callable[[int], tuple[Array, Array]] = lambda number: (np.zeros((0, 2)), np.zeros(0)),
    ) -> None:
        """adjusted: where a keyframe shows landmarks without depth, uv (N, 2) [px], and their depth (N,) [m], where that is known."""
        self.graph, self.features, self.adjusted = graph, features, adjusted
        self.hosts: list[HostCorners] = []

    def state(self) -> State:
        """The corners."""
        return {"hosts": [host.state() for host in self.hosts]}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.hosts = [HostCorners.from_state(host) for host in state["hosts"]]

    def begin(self, number: int) -> None:
        """Begins with the corners of a stored keyframe, unless the last host is that one."""
        if not self.hosts or self.hosts[-1].keyframe != number:
            self.hosts.append(HostCorners.of(number, self.graph.keyframes[number], self.features, *self.adjusted(number)))

    def search(self, grey: Tensor, T_wc: Tensor, moving: NDArray[np.bool_] | None = None) -> SeenCorners:
        """The corners of the last host that an image (H, W) at about T_wc (4, 4) shows. moving: (H, W) the pixels of what moves in it."""
        host = self.hosts[-1]
        keyframe = self.graph.keyframes[host.keyframe]
        features = self.features.images_of(keyframe)
        model, T_fk = CameraModel.as_stated(features.grey_camera), (se3.inverse(T_wc) @ keyframe.T_wk).numpy()
        near, distant = (search(patches, features.grey, grey, T_fk, model) for patches in (host.near, host.distant.at(0.5)))
        corner = np.concatenate([near.patch, len(host.near) + distant.patch])
        uv, covariance = (np.concatenate([a, b]) for a, b in ((near.uv, distant.uv), (near.covariance, distant.covariance)))
        seen = SeenCorners(len(self.hosts) - 1, corner, uv, covariance)
        return seen if moving is None else seen[~shows(moving, uv, features.grey_camera)]

    def narrow(self, seen: SeenCorners, T_wc: Tensor) -> SeenCorners:
        """Narrows the intervals of corners without depth that an image at T_wc (4, 4) shows. Returns all that fit."""
        host = self.hosts[seen.host]
        keyframe, count = self.graph.keyframes[host.keyframe], len(host.near)
        is_distant = seen.corner >= count
        found = Found(seen.corner[is_distant] - count, seen.uv[is_distant], seen.covariance[is_distant], np.zeros(0))
        T_fk, model = (se3.inverse(T_wc) @ keyframe.T_wk).numpy(), CameraModel.as_stated(self.features.images_of(keyframe).grey_camera)
        fits = ~is_distant
        fits[is_distant] = host.distant.narrow_by(found, T_fk, model)
        return seen[fits]


def shows(pixels: NDArray[np.bool_], uv: Array, camera: Camera) -> NDArray[np.bool_]:
    """(N,) the pixels of an image (H, W) nearest to places uv (N, 2) in one of a camera."""
    rows, columns = pixels.shape
    u, v = np.rint((uv + 0.5) * [columns / camera.width, rows / camera.height] - 0.5).astype(np.int64).T
    return np.asarray(pixels[v.clip(0, rows - 1), u.clip(0, columns - 1)])
