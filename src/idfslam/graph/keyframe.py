"""A keyframe: a frame that is kept, its pose, and what components remember of it."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.graph.archive import Archive, Stored
from idfslam.mapping.sampling import CellPixels
from idfslam.storage.state import State

_EIGHT_BITS = np.float32(1 / 255)  # colour of most cameras comes in such steps


class Description(Protocol):
    """What the tracker keeps of a frame."""

    def packed(self) -> tuple[list[Tensor], Callable[[Sequence[Tensor]], Any]]:
        """Its tensors, and what makes a description of them again."""
        ...


class Keyframe:
    """A frame that is kept, its pose, and what components remember of it.

    Its images and its description may be put away into an archive; whoever asks for them has them again.
    """

    def __init__(self, frame: Frame, T_wk: Tensor, depth: Tensor, colour: Tensor) -> None:
        """T_wk (4, 4) float64; depth (H, W) [m] and colour (H, W, 3) in [0, 1] on the map's device."""
        self.T_wk = T_wk
        self.index, self.timestamp = frame.index, frame.timestamp
        self.camera: Camera = frame.camera
        self._images: tuple[Frame, Tensor, Tensor] | None = (frame, depth, colour)
        self._device = depth.device
        self._description: Any = None
        self._archive: Archive | None = None
        self._images_at: Stored | None = None  # in the archive
        self._description_at: tuple[Stored, Callable[[Sequence[Tensor]], Any]] | None = None
        self._checksum: int | None = None  # of the images
        self.pixels: CellPixels | None = None  # those with depth, by cell
        self.appearance: Any = None  # the aligner's image pyramid of it
        self.cell_losses: Tensor | None = None  # (8, 8) for active sampling
        self.landmarks: Any = None  # the aligner's landmarks in it
        self.unlearnt = 0  # updates of the map that have yet to learn it where a loop has moved it
        self.place: Tensor | None = None  # what the place looks like (tracking/place.py)
        self.anchor = 0  # the stored keyframe that it is, or that it hangs on
        self.piece = 0  # the first stored keyframe of its part of the graph (graph/pieces.py)
        self.neighbours: set[int] = set()  # stored keyframes it is connected with, by its pose
        self.linked: set[int] = set()  # of these, those whose pose relative to it was measured, not merely carried on
        self.unlinked: list[int] = []  # the others, most covisible first
        self.alike: list[int] = []  # neighbours that see most of what it sees, oldest first

    @property
    def frame(self) -> Frame:
        return self._loaded()[0]

    @property
    def depth(self) -> Tensor:
        return self._loaded()[1]

    @property
    def colour(self) -> Tensor:
        return self._loaded()[2]

    @cached_property
    def farthest(self) -> float:
        """Its farthest reading [m]; 0: it has no depth."""
        return float(self.depth.max())

    @cached_property
    def has_depth(self) -> bool:
        """Whether any of its pixels has a reading."""
        return bool((self.depth > 0).any())

    @property
    def described(self) -> Any:
        """The tracker's features of it; None before they were worked out."""
        description = self._description
        if description is None and self._description_at is not None:
            assert self._archive is not None
            stored, unpacked = self._description_at
            self._description = description = unpacked(self._archive.read(stored))
            self._archive.used(self.anchor, self)
        return description

    @described.setter
    def described(self, description: Description) -> None:
        self._description = description

    def _loaded(self) -> tuple[Frame, Tensor, Tensor]:
        if self._images is None:
            assert self._archive is not None and self._images_at is not None
            colour, depth = self._archive.read(self._images_at)
            if colour.dtype == torch.uint8:
                colour = torch.from_numpy(np.multiply(colour.numpy(), _EIGHT_BITS, dtype=np.float32))
            frame = Frame(self.index, self.timestamp, colour.numpy(), depth.numpy(), self.camera)
            self._images = frame, depth.to(self._device), colour.to(self._device)
        images = self._images
        if self._archive is not None:
            self._archive.used(self.anchor, self)
        return images

    def keep_in(self, archive: Archive) -> None:
        """From now on the archive says how long images and description stay in memory."""
        self._archive = archive
        archive.used(self.anchor, self)

    def put_away(self) -> None:
        """Lets go of images and description, which never change and are written once, and of all that can be worked out again."""
        assert self._archive is not None
        if self._images is not None and self._images_at is None:
            self._images_at = self._archive.write(_reduced_to_bytes(self._images[0]))
        if self._description is not None and self._description_at is None:
            tensors, unpacked = self._description.packed()
            self._description_at = self._archive.write(tensors), unpacked
        self._images = self._description = self.pixels = self.appearance = None

    def state(self) -> State:
        """All but the images and what is worked out from them."""
        if self._checksum is None:
            self._checksum = self.frame.checksum()
        links = {"neighbours": sorted(self.neighbours), "linked": sorted(self.linked), "unlinked": self.unlinked, "alike": self.alike}
        own = {"T_wk": self.T_wk, "cell_losses": self.cell_losses, "place": self.place, "anchor": self.anchor, "unlearnt": self.unlearnt}
        own["piece"] = self.piece
        return {"index": self.index, "images": self._checksum, **own, **links}

    def restore(self, state: State) -> None:
        """What `state` told, for a keyframe of the same frame."""
        self.T_wk, self.anchor, self._checksum = state["T_wk"], state["anchor"], state["images"]
        self.unlearnt, self.piece = state["unlearnt"], state["piece"]
        self.neighbours, self.linked = set(state["neighbours"]), set(state["linked"])
        self.unlinked, self.alike = state["unlinked"], state["alike"]
        for name in ("cell_losses", "place"):
            setattr(self, name, None if state[name] is None else state[name].to(self._device))


def _reduced_to_bytes(frame: Frame) -> tuple[Tensor, Tensor]:
    """A frame's colour, in whole steps where it came in such, and its depth."""
    steps = np.rint(frame.colour * 255).astype(np.uint8)
    exact = np.array_equal(steps * _EIGHT_BITS, frame.colour)
    return torch.from_numpy(steps if exact else frame.colour), torch.from_numpy(frame.depth)
