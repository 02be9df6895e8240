"""Loads recordings for pretraining: pairs of reduced, cropped views without any pose."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.errors import FrameError, RecordingError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.tracking.frame_features import reduced


class FrameSequence(Protocol):
    """A sequence of frames; pretraining needs no poses."""

    @property
    def name(self) -> str: ...

    @property
    def camera(self) -> Camera: ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Frame: ...


@dataclass(frozen=True)
class PairView:
    """One image of a pair: colour (3, h, w) in [0, 1], points (h, w, 3) [m] in its own camera's frame (z = 0: no depth)."""

    colour: Tensor
    points: Tensor
    camera: Camera

    @property
    def valid(self) -> Tensor:
        """(h, w) bool: pixels with depth."""
        return self.points[..., 2] > 0

    def to(self, device: torch.device) -> "PairView":
        """A copy on another device."""
        return replace(self, colour=self.colour.to(device), points=self.points.to(device))


@dataclass(frozen=True)
class Pair:
    """The input of a training step: two views without poses."""

    a: PairView
    b: PairView

    def to(self, device: torch.device) -> "Pair":
        """A copy on another device."""
        return Pair(self.a.to(device), self.b.to(device))


@dataclass(frozen=True)
class Footage:
    """A recording's reduced frames in memory: 96 kB each at 160 x 120 pixels, 1 GB for 10 000 frames."""

    colour: NDArray[np.uint8]  # (N, h, w, 3)
    depth: NDArray[np.uint16]  # (N, h, w) [mm]
    camera: Camera

    def __len__(self) -> int:
        return len(self.colour)

    def view(self, index: int, top: int, left: int, crop: tuple[int, int]) -> PairView:
        """The crop of a frame whose first row and column are `top` and `left`."""
        rows, columns = slice(top, top + crop[0]), slice(left, left + crop[1])
        camera = replace(self.camera, width=crop[1], height=crop[0], cx=self.camera.cx - left, cy=self.camera.cy - top)
        colour = torch.from_numpy(self.colour[index, rows, columns]).permute(2, 0, 1).float() / 255
        depth = torch.from_numpy(self.depth[index, rows, columns].astype(np.float32)) / 1000
        return PairView(colour, camera.backproject(depth), camera)

    def whole(self, index: int) -> PairView:
        """The frame without a crop."""
        return self.view(index, 0, 0, (self.camera.height, self.camera.width))


def load_footage(recording: FrameSequence, height: int, indices: Sequence[int] | None = None) -> Footage:
    """Loads and reduces frames of the recording. indices: None: all. An unreadable frame is blank, so it has no matches.

    Raises RecordingError for a recording of fewer than two frames.
    """
    if len(recording) < 2:
        raise RecordingError(f"{recording.name}: found {len(recording)} frames, expected at least two; pretraining learns from pairs")
    chosen = range(len(recording)) if indices is None else indices
    _, blank, camera = reduced(Frame.blank(0, 0.0, recording.camera), height)
    colours = np.zeros((len(chosen), *blank.shape, 3), np.uint8)
    depths = np.zeros((len(chosen), *blank.shape), np.uint16)
    for place, i in enumerate(chosen):
        try:
            colour, depth, _ = reduced(recording[i], height)
        except FrameError:
            continue
        colours[place] = colour * 255 + 0.5
        depths[place] = np.minimum(depth * 1000 + 0.5, np.iinfo(np.uint16).max)
    return Footage(colours, depths, camera)


def sample_pair(footage: Sequence[Footage], *, gap: int, crop: tuple[int, int], generator: torch.Generator) -> Pair:
    """A random pair of a random recording, 1 to `gap` frames apart, in random order; both have the same random crop."""

    def draw(low: int, high: int) -> int:
        return int(torch.randint(low, high + 1, (), generator=generator))

    film = footage[draw(0, len(footage) - 1)]
    apart = draw(1, min(gap, len(film) - 1))
    first = draw(0, len(film) - 1 - apart)
    crop = min(crop[0], film.camera.height), min(crop[1], film.camera.width)
    top, left = draw(0, film.camera.height - crop[0]), draw(0, film.camera.width - crop[1])
    views = [film.view(i, top, left, crop) for i in (first, first + apart)]
    return Pair(*views) if draw(0, 1) else Pair(*reversed(views))
