"""A keyframe: a frame that is kept, its pose, and what components remember of it."""

from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.graph.archive import Archive
from idfslam.mapping.sampling import CellPixels
from idfslam.state import State


class Keyframe:
    """A frame that is kept, its pose, and what components remember of it.

    Its images may be put away into an archive; whoever asks for them has them again.
    """

    def __init__(self, frame: Frame, T_wk: Tensor, depth: Tensor, colour: Tensor) -> None:
        """T_wk (4, 4) float64; depth (H, W) [m] and colour (H, W, 3) in [0, 1] on the map's device."""
        self.T_wk = T_wk
        self.index, self.timestamp = frame.index, frame.timestamp
        self.camera: Camera = frame.camera
        self._images: tuple[Frame, Tensor, Tensor] | None = (frame, depth, colour)
        self._device = depth.device
        self._archive: Archive | None = None
        self._checksum: int | None = None  # of the images
        self.described: Any = None  # the tracker's features of it
        self.pixels: CellPixels | None = None  # those with depth, by cell
        self.appearance: Any = None  # the aligner's image pyramid of it
        self.cell_losses: Tensor | None = None  # (8, 8) for active sampling
        self.landmarks: Any = None  # the aligner's landmarks in it
        self.unlearnt = 0  # updates of the map that have yet to learn it where a loop has moved it
        self.place: Tensor | None = None  # what the place looks like (tracking/place.py)
        self.anchor = 0  # the stored keyframe that it is, or that it hangs on
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

    def _loaded(self) -> tuple[Frame, Tensor, Tensor]:
        if self._images is None:
            assert self._archive is not None
            frame = self._archive.load(self.anchor)
            self._images = frame, torch.from_numpy(frame.depth).to(self._device), torch.from_numpy(frame.colour).to(self._device)
        images = self._images
        if self._archive is not None:
            self._archive.used(self.anchor, self)
        return images

    def keep_in(self, archive: Archive) -> None:
        """From now on the archive says how long the images stay in memory."""
        self._archive = archive
        archive.used(self.anchor, self)

    def put_away(self) -> Frame:
        """Lets go of the images and of all that can be worked out from them again."""
        assert self._images is not None
        frame = self._images[0]
        self._images = self.described = self.pixels = self.appearance = None
        return frame

    def state(self) -> State:
        """All but the images and what is worked out from them."""
        if self._checksum is None:
            self._checksum = self.frame.checksum()
        links = {"neighbours": sorted(self.neighbours), "linked": sorted(self.linked), "unlinked": self.unlinked, "alike": self.alike}
        own = {"T_wk": self.T_wk, "cell_losses": self.cell_losses, "place": self.place, "anchor": self.anchor, "unlearnt": self.unlearnt}
        return {"index": self.index, "images": self._checksum, **own, **links}

    def restore(self, state: State) -> None:
        """What `state` told, for a keyframe of the same frame."""
        self.T_wk, self.anchor, self._checksum = state["T_wk"], state["anchor"], state["images"]
        self.unlearnt = state["unlearnt"]
        self.neighbours, self.linked = set(state["neighbours"]), set(state["linked"])
        self.unlinked, self.alike = state["unlinked"], state["alike"]
        for name in ("cell_losses", "place"):
            setattr(self, name, None if state[name] is None else state[name].to(self._device))
