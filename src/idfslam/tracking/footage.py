"""Recordings as pretraining sees them: pairs of views, reduced, cropped and augmented, without any pose."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from idfslam.errors import FrameError, RecordingError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.tracking.description import reduced


class Recording(Protocol):
    """What pretraining needs of a data set: frames. It asks for no pose."""

    @property
    def name(self) -> str: ...

    @property
    def camera(self) -> Camera: ...

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Frame: ...


@dataclass(frozen=True)
class View:
    """One image of a pair: colour (3, h, w) in [0, 1], points (h, w, 3) [m] in its own camera's frame (z = 0: no depth)."""

    colour: Tensor
    points: Tensor
    camera: Camera

    @property
    def valid(self) -> Tensor:
        """(h, w) bool: pixels with depth."""
        return self.points[..., 2] > 0


@dataclass(frozen=True)
class Pair:
    """What a training step sees: two views, and no pose of either."""

    a: View
    b: View


@dataclass(frozen=True)
class Footage:
    """A recording's frames, reduced and held in memory."""

    colour: NDArray[np.uint8]  # (N, h, w, 3)
    depth: NDArray[np.float32]  # (N, h, w) [m]
    camera: Camera

    def view(self, index: int, top: int, left: int, crop: tuple[int, int]) -> View:
        """The crop of a frame whose first row and column are `top` and `left`."""
        rows, columns = slice(top, top + crop[0]), slice(left, left + crop[1])
        camera = replace(self.camera, width=crop[1], height=crop[0], cx=self.camera.cx - left, cy=self.camera.cy - top)
        colour = torch.from_numpy(self.colour[index, rows, columns]).permute(2, 0, 1).float() / 255
        return View(colour, camera.backproject(torch.from_numpy(self.depth[index, rows, columns])), camera)


def load_footage(recording: Recording, height: int) -> Footage:
    """All frames of the recording, reduced; one that cannot be read is blank, and finds no matches.

    Raises RecordingError for a recording of fewer than two frames.
    """
    if len(recording) < 2:
        raise RecordingError(f"{recording.name}: found {len(recording)} frames, expected at least two; pretraining learns from pairs")
    colours: list[NDArray[np.uint8]] = []
    depths: list[NDArray[np.float32]] = []
    for i in range(len(recording)):
        try:
            frame = recording[i]
        except FrameError:
            frame = Frame.blank(i, 0.0, recording.camera)
        colour, depth, camera = reduced(frame, height)
        colours.append((colour * 255 + 0.5).astype(np.uint8))
        depths.append(depth)
    return Footage(np.stack(colours), np.stack(depths), camera)


def sample_pair(footage: Sequence[Footage], *, gap: int, crop: tuple[int, int], generator: torch.Generator) -> Pair:
    """A random pair of one recording, 1 to `gap` frames apart in either order, the same random crop of both."""

    def draw(low: int, high: int) -> int:
        return int(torch.randint(low, high + 1, (), generator=generator))

    film = footage[draw(0, len(footage) - 1)]
    apart = draw(1, min(gap, len(film.colour) - 1))
    first = draw(0, len(film.colour) - 1 - apart)
    crop = min(crop[0], film.camera.height), min(crop[1], film.camera.width)
    top, left = draw(0, film.camera.height - crop[0]), draw(0, film.camera.width - crop[1])
    views = [film.view(i, top, left, crop) for i in (first, first + apart)]
    return Pair(*views) if draw(0, 1) else Pair(*reversed(views))


def augmented(colour: Tensor, strength: float, generator: torch.Generator) -> Tensor:
    """An image (3, h, w) under another exposure, gamma and white balance, with noise and, at times, out of focus."""

    def draw(*size: int) -> Tensor:
        return strength * (2 * torch.rand(*size, generator=generator) - 1)

    out = colour.clamp(min=1e-4) ** torch.exp(0.3 * draw(1)) * torch.exp(0.3 * draw(1) + 0.1 * draw(3))[:, None, None]
    out = out + 0.1 * draw(1)
    if float(draw(1)) > 0.4:
        out = F.avg_pool2d(out[None], 3, 1, 1, count_include_pad=False)[0]
    return (out + 0.03 * draw(1).abs() * torch.randn(out.shape, generator=generator)).clamp(0, 1)
