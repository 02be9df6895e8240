"""A keyframe: a frame that is kept, its pose, and its relations to the other keyframes of the graph.

What other parts work out from a keyframe (image pyramids, landmarks, pixel groups, descriptors) belongs to those parts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.graph.archive import Archive, Stored
from idfslam.storage.state import State

_EIGHT_BITS = np.float32(1 / 255)  # most cameras give colour in such steps


class ArchivedFeatures(Protocol):
    """What the tracker keeps of a frame, as the archive sees it."""

    def packed(self) -> tuple[list[Tensor], Callable[[Sequence[Tensor]], Any]]:
        """The tensors, and a function that makes the features of them again."""
        ...


@dataclass(frozen=True, eq=False)
class Images:
    """The images of one frame. What is worked out from them can be keyed by this object: it goes when the images are put away."""

    frame: Frame
    depth: Tensor  # (H, W) [m] on the map's device, 0 = no reading
    colour: Tensor  # (H, W, 3) in [0, 1] on the map's device


class Keyframe:
    """A frame with a pose. The graph alone changes its pose and relations.

    The archive may put its images and features away; whoever asks for them gets them again.
    """

    def __init__(self, frame: Frame, T_wk: Tensor, depth: Tensor, colour: Tensor) -> None:
        """T_wk (4, 4) float64; depth (H, W) [m] and colour (H, W, 3) in [0, 1] on the map's device."""
        self.T_wk = T_wk
        self.index, self.timestamp = frame.index, frame.timestamp
        self.camera: Camera = frame.camera
        self.host = 0  # the stored keyframe that it is, or, of a culled one, that it hangs on
        self.submap = 0  # the first stored keyframe of its submap
        self.covisible: set[int] = set()  # stored keyframes that see the same, judging by the poses (Eq. 5)
        self.edges: set[int] = set()  # of these, those whose relative pose was measured: edges of the pose graph
        self.unverified: list[int] = []  # of these, those without an edge, the most covisible first
        self.covisible_references: list[int] = []  # stored keyframes that see most of what it sees, the oldest first
        self._device = depth.device
        self._images: Images | None = Images(frame, depth, colour)
        self._features: Any = None
        self._archive: Archive | None = None
        self._images_at: Stored | None = None
        self._features_at: tuple[Stored, Callable[[Sequence[Tensor]], Any]] | None = None
        self._checksum: int | None = None  # of the images

    @property
    def images(self) -> Images:
        """Its images, from the archive where they are not in memory."""
        if self._images is None:
            assert self._archive is not None and self._images_at is not None
            colour, depth = self._archive.read(self._images_at)
            if colour.dtype == torch.uint8:
                colour = torch.from_numpy(np.multiply(colour.numpy(), _EIGHT_BITS, dtype=np.float32))
            frame = Frame(self.index, self.timestamp, colour.numpy(), depth.numpy(), self.camera)
            self._images = Images(frame, depth.to(self._device), colour.to(self._device))
        images = self._images
        if self._archive is not None:
            self._archive.used(self.host, self)
        return images

    @property
    def frame(self) -> Frame:
        return self.images.frame

    @property
    def depth(self) -> Tensor:
        """(H, W) [m], 0 = no reading."""
        return self.images.depth

    @property
    def colour(self) -> Tensor:
        """(H, W, 3) in [0, 1]."""
        return self.images.colour

    @cached_property
    def farthest(self) -> float:
        """Its farthest reading [m]; 0 if it has no depth."""
        return float(self.depth.max())

    @cached_property
    def has_depth(self) -> bool:
        """Whether any of its pixels has a reading."""
        return bool((self.depth > 0).any())

    @property
    def features(self) -> Any:
        """The tracker's features of it; None before they were extracted."""
        features = self._features
        if features is None and self._features_at is not None:
            assert self._archive is not None
            stored, unpack = self._features_at
            self._features = features = unpack(self._archive.read(stored))
            self._archive.used(self.host, self)
        return features

    def keep_features(self, features: ArchivedFeatures) -> None:
        """Keeps the tracker's features with the images."""
        self._features = features

    def keep_in(self, archive: Archive) -> None:
        """From now on the archive decides how long images and features stay in memory."""
        self._archive = archive
        archive.used(self.host, self)

    def put_away(self) -> None:
        """Releases images and features from memory. They never change, so each is written to the archive once."""
        assert self._archive is not None
        if self._images is not None and self._images_at is None:
            self._images_at = self._archive.write(_reduced_to_bytes(self._images.frame))
        if self._features is not None and self._features_at is None:
            tensors, unpack = self._features.packed()
            self._features_at = self._archive.write(tensors), unpack
        self._images = self._features = None

    def state(self) -> State:
        """Pose and relations, and a checksum of the images."""
        if self._checksum is None:
            self._checksum = self.frame.checksum()
        return {
            "index": self.index,
            "images": self._checksum,
            "T_wk": self.T_wk,
            "host": self.host,
            "submap": self.submap,
            "covisible": sorted(self.covisible),
            "edges": sorted(self.edges),
            "unverified": self.unverified,
            "covisible_references": self.covisible_references,
        }

    def restore(self, state: State) -> None:
        """Takes over the `state` of a keyframe of the same frame."""
        self.T_wk, self._checksum = state["T_wk"], state["images"]
        self.host, self.submap = state["host"], state["submap"]
        self.covisible, self.edges = set(state["covisible"]), set(state["edges"])
        self.unverified, self.covisible_references = state["unverified"], state["covisible_references"]


def _reduced_to_bytes(frame: Frame) -> tuple[Tensor, Tensor]:
    """A frame's colour, in bytes where that loses nothing, and its depth."""
    steps = np.rint(frame.colour * 255).astype(np.uint8)
    exact = np.array_equal(steps * _EIGHT_BITS, frame.colour)
    return torch.from_numpy(steps if exact else frame.colour), torch.from_numpy(frame.depth)
