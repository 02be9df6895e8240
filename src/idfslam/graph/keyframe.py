"""A keyframe: a frame, its pose, and its relations to the other keyframes of the graph.

Each frame that is processed is an object of this class. It is called a view until it is selected.

What other parts compute from a keyframe (image pyramids, landmarks, pixel groups, descriptors) belongs to those parts.
"""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.frame import Frame
from idfslam.graph.keyframe_images import KeyframeImages
from idfslam.sensing.rectification import Rectification, RowTimes
from idfslam.storage.state import State


class Keyframe(KeyframeImages):
    """A frame with a pose. Tracking sets the pose of a view; once it is a keyframe, only the graph moves and connects it."""

    def __init__(self, frame: Frame, T_wk: Tensor, depth: Tensor, colour: Tensor) -> None:
        """T_wk (4, 4) float64; depth (H, W) [m] and colour (H, W, 3) in [0, 1] on the map's device."""
        super().__init__(frame, depth, colour)
        self.T_wk = T_wk
        self.host = 0  # number of this keyframe if it is stored; else of the stored keyframe that its pose is relative to
        self.submap = 0  # number of the first stored keyframe of its submap
        self.covisible: set[int] = set()  # stored keyframes that are covisible at the present poses (Eq. 5)
        self.edges: set[int] = set()  # stored keyframes whose relative pose was measured: edges of the pose graph
        self.unverified: list[int] = []  # covisible keyframes without an edge, the most covisible first
        self.covisible_references: list[int] = []  # stored keyframes that see most of what it sees, the oldest first
        self.velocity: NDArray[np.float64] | None = None  # (6,) along the camera's axes [m/s, rad/s]; None: not estimated
        self.velocity_covariance: NDArray[np.float64] | None = None  # (6, 6) of it
        self.colour_since = frame.index  # the frame that showed its colour image first: an earlier one if the image is repeated
        self.registered = False  # whether a registration gave or confirmed its pose in a wide step: the map does not move it

    @property
    def colour_is_older(self) -> bool:
        """Whether its colour image is that of an earlier frame, once more."""
        return self.colour_since < self.index

    def state(self) -> State:
        """Pose and relations, and a checksum of the images."""
        return {
            "index": self.index,
            "images": self.checksum,
            "T_wk": self.T_wk,
            "host": self.host,
            "submap": self.submap,
            "covisible": sorted(self.covisible),
            "edges": sorted(self.edges),
            "unverified": self.unverified,
            "covisible_references": self.covisible_references,
            "velocity": None if self.velocity is None else torch.from_numpy(self.velocity),
            "velocity_covariance": None if self.velocity_covariance is None else torch.from_numpy(self.velocity_covariance),
            "registered": self.registered,
            "moving": None if self.moving is None else torch.from_numpy(np.packbits(self.moving)),
            "rectification": _state_of(self.rectification, self.earlier_times),
        }

    def restore(self, state: State) -> None:
        """Takes over the `state` of a keyframe of the same frame."""
        self.T_wk, self._checksum = state["T_wk"], state["images"]
        self.host, self.submap = state["host"], state["submap"]
        self.covisible, self.edges = set(state["covisible"]), set(state["edges"])
        self.unverified, self.covisible_references = state["unverified"], state["covisible_references"]
        self.velocity, self.velocity_covariance = (
            None if state[key] is None else state[key].numpy().copy() for key in ("velocity", "velocity_covariance")
        )
        self.registered = state["registered"]
        if (moving := state["moving"]) is not None:
            shape = self.camera.height, self.camera.width
            self.hide(np.unpackbits(moving.numpy(), count=shape[0] * shape[1]).reshape(shape).astype(np.bool_))

    def rectify_again(self, state: State) -> None:
        """Rectifies the images, which are as they were taken, as those of the keyframe of `state` were."""
        if (kept := state["rectification"]) is not None:
            first, *later = [RowTimes(*times) for times in kept["times"]]
            self.rectify(Rectification(first, kept["velocity"].numpy().copy()))
            for times in later:
                self.rectify_further(times)


def _state_of(rectification: Rectification | None, earlier: Sequence[RowTimes]) -> State | None:
    """The velocity, and all times that the images were rectified with one after the other."""
    if rectification is None:
        return None
    times = [[t.readout, t.depth_readout, t.depth_delay] for t in (*earlier, rectification.times)]
    return {"times": times, "velocity": torch.from_numpy(rectification.velocity)}
