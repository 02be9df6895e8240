"""The images of a keyframe: rectified, without what moves, and in the swap file while they are not in use."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.graph.swap_file import Stored, SwapFile
from idfslam.sensing.clipping import is_clipped
from idfslam.sensing.rectification import Rectification, RowTimes, rectified

# [1] Share of the cells of a grid over the image with a reading, from which the image has depth. More: an object without its background,
# and a place that is mostly out of the sensor's range, are not mapped. A fifth of the image's width and height is enough.
_LEAST_DEPTH = 0.04
_GRID = 12, 16  # rows and columns of these cells; more: sparse depth covers less of them. Chosen by hand
_EIGHT_BITS = np.float32(1 / 255)  # step of a colour channel of 8 bits, as most cameras have it


class SwappableFeatures(Protocol):
    """The tracker's features of a frame, as the swap file sees them."""

    def packed(self) -> tuple[list[Tensor], Callable[[Sequence[Tensor]], Any]]:
        """The tensors, and a function that makes the features from them again."""
        ...


@dataclass(frozen=True, eq=False)
class Images:
    """The images of one frame. A weak cache of what is computed from them can use this object as its key: it dies with the images."""

    frame: Frame
    depth: Tensor  # (H, W) [m] on the map's device, 0 = no reading
    colour: Tensor  # (H, W, 3) in [0, 1] on the map's device
    moving: NDArray[np.bool_] | None = None  # (H, W) pixels that show what moves, whose depth was taken out; None: none

    @cached_property
    def readings(self) -> int:
        """The number of pixels with depth."""
        return int(np.count_nonzero(self.frame.depth > 0))  # counting truth values is six times as fast as counting numbers


class KeyframeImages:
    """The images of a frame, and the tracker's features of them.

    The swap file may take both out of memory. They are read again on the next access.
    """

    def __init__(self, frame: Frame, depth: Tensor, colour: Tensor) -> None:
        """depth (H, W) [m] and colour (H, W, 3) in [0, 1] on the map's device."""
        self.index, self.timestamp = frame.index, frame.timestamp
        self.camera: Camera = frame.camera
        self.timing, self.depth_lag = frame.timing, frame.depth_lag  # of the images as they were taken
        self._times = frame.depth_timestamp, frame.timing
        self.is_clipped = is_clipped(frame.colour)  # whether the colour image is black or white, and shows nothing
        self.rectification: Rectification | None = None  # what the images are rectified with; None: they are as they were taken
        self.earlier_times: tuple[RowTimes, ...] = ()  # that they were rectified with before more was known of the sensor, in their order
        self.moving: NDArray[np.bool_] | None = None  # (H, W) pixels that are hidden since they show what moves; None: none
        self._shown: dict[str, tuple[Images, Images]] = {}  # the images, and what is left of them without these pixels
        self._device = depth.device
        self._images: Images | None = Images(frame, depth, colour)
        self._taken: Images | None = None  # the images before rectification, until the swap file gets them
        self._features: Any = None
        self._swap: SwapFile | None = None
        self._number = 0  # by which the swap file knows them
        self._images_at: Stored | None = None
        self._features_at: tuple[Stored, Callable[[Sequence[Tensor]], Any]] | None = None
        self._checksum: int | None = None  # of the images

    @property
    def images(self) -> Images:
        """The images, rectified, without the depth of what moves."""
        return self._without_movers("images", self.unmasked)

    @property
    def unmasked(self) -> Images:
        """The images with what moves, rectified; they are read from the swap file if they are not in memory."""
        if self._images is None and self._taken is not None:
            assert self.rectification is not None
            self._images = self._rectified(self._taken, self.rectification)
        if self._images is None:
            assert self._swap is not None and self._images_at is not None
            colour, depth = self._swap.read(self._images_at)
            if colour.dtype == torch.uint8:
                colour = torch.from_numpy(np.multiply(colour.numpy(), _EIGHT_BITS, dtype=np.float32))
            frame = Frame(self.index, self.timestamp, colour.numpy(), depth.numpy(), self.camera, *self._times)
            self._images = Images(frame, depth.to(self._device), colour.to(self._device))
        images = self._images
        if self._swap is not None:
            self._swap.used(self._number, self)
        return images

    @property
    def taken(self) -> Images:
        """The images as they were taken, before rectification, without the depth of what moves.

        A stored keyframe has the rectified ones alone.
        """
        return self._without_movers("taken", self.taken_unmasked)

    @property
    def rectification_of_taken(self) -> Rectification | None:
        """What `taken` is rectified with to become `images`; None where they are the same."""
        return None if self._taken is None else self.rectification

    @property
    def taken_unmasked(self) -> Images:
        """The images as they were taken, before rectification, with the depth of what moves."""
        return self._taken or self.unmasked

    def hide(self, moving: NDArray[np.bool_] | None) -> None:
        """Hides the pixels (H, W) that show what moves, and no others: their depth is left out everywhere. None: nothing is hidden."""
        before, self.moving = self.moving, moving if moving is not None and moving.any() else None
        same = self.moving is before or (before is not None and self.moving is not None and np.array_equal(before, self.moving))
        if not same:
            self._forget_derived()

    def _without_movers(self, name: str, images: Images) -> Images:
        if self.moving is None:
            return images
        if name not in self._shown or self._shown[name][0] is not images:
            depth = torch.from_numpy(images.frame.depth).masked_fill(torch.from_numpy(self.moving), 0)
            shown = Images(replace(images.frame, depth=depth.numpy()), depth.to(self._device), images.colour, self.moving)
            self._shown[name] = images, shown
        return self._shown[name][1]

    def rectify(self, rectification: Rectification) -> None:
        """Rectifies the images as they were taken, when they are next asked for. What was computed from others is forgotten."""
        self._taken, self._images, self.rectification = self.taken_unmasked, None, rectification
        self.earlier_times = ()
        self._forget_derived()
        self._images_at = self._checksum = None
        if self._swap is not None:
            self._keep_rectified()

    def rectify_further(self, times: RowTimes) -> None:
        """Carries rectified images to what these times make of them, with the same velocity.

        Those as they were taken need not be there any more: what is left to carry is the difference to the times that were in use.
        """
        done, earlier = self.rectification, self.earlier_times
        assert done is not None
        self._keep_rectified()
        self.rectify(Rectification(RowTimes(*map(float, times.array - done.times.array)), done.velocity))
        self._keep_rectified()
        self.rectification, self.earlier_times = Rectification(times, done.velocity), (*earlier, done.times)

    def _forget_derived(self) -> None:
        """Forgets what was computed from images that have changed."""
        self._shown.clear()
        self._features = self._features_at = None
        for name in ("farthest", "depth_share"):
            self.__dict__.pop(name, None)

    def _rectified(self, taken: Images, rectification: Rectification) -> Images:
        frame = rectified(taken.frame, rectification)
        if frame is taken.frame:
            return taken
        return Images(frame, torch.from_numpy(frame.depth).to(self._device), torch.from_numpy(frame.colour).to(self._device))

    def _keep_rectified(self) -> None:
        """Forgets the images as they were taken, after rectification."""
        self._images, self._taken = self.unmasked, None
        self._times = self._images.frame.depth_timestamp, self._images.frame.timing

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
        """The farthest depth reading [m]; 0 without depth."""
        return float(self.depth.max())

    @property
    def has_depth(self) -> bool:
        """Whether enough of the image has depth for it to be mapped."""
        return self.depth_share >= _LEAST_DEPTH

    @cached_property
    def depth_share(self) -> float:
        """[1] The share of the cells of a grid over the image that have a reading."""
        depth = self.taken.frame.depth
        rows, columns = (np.arange(cells) * size // cells for cells, size in zip(_GRID, depth.shape))
        return float(np.mean(np.logical_or.reduceat(np.logical_or.reduceat(depth > 0, rows, axis=0), columns, axis=1)))

    @property
    def features(self) -> Any:
        """The tracker's features of the frame; None before they were extracted."""
        features = self._features
        if features is None and self._features_at is not None:
            assert self._swap is not None
            stored, unpack = self._features_at
            self._features = features = unpack(self._swap.read(stored))
            self._swap.used(self._number, self)
        return features

    def keep_features(self, features: SwappableFeatures) -> None:
        """Keeps the tracker's features with the images."""
        self._features = features

    def keep_in(self, swap: SwapFile, number: int) -> None:
        """Hands the images and features to a swap file, which decides how long they stay in memory. number: by which it knows them."""
        self._keep_rectified()
        self._swap, self._number = swap, number
        swap.used(number, self)

    def swap_out(self) -> None:
        """Releases images and features from memory. They hardly ever change, so what the file has is not written again.

        What the file has no room for stays in memory.
        """
        assert self._swap is not None
        if self._images is not None and self._images_at is None and not self._swap.full:
            self._images_at = self._swap.write(_reduced_to_bytes(self._images.frame))
        if self._features is not None and self._features_at is None and not self._swap.full:
            tensors, unpack = self._features.packed()
            stored = self._swap.write(tensors)
            self._features_at = None if stored is None else (stored, unpack)
        self._images = None if self._images_at else self._images
        self._shown.clear()
        self._features = None if self._features_at else self._features

    @property
    def checksum(self) -> int:
        """A checksum of the images, with what moves."""
        if self._checksum is None:
            self._checksum = self.unmasked.frame.checksum()
        return self._checksum


def _reduced_to_bytes(frame: Frame) -> tuple[Tensor, Tensor]:
    """A frame's colour, in bytes if that loses nothing, and its depth."""
    steps = np.rint(frame.colour * 255).astype(np.uint8)
    exact = np.array_equal(steps * _EIGHT_BITS, frame.colour)
    return torch.from_numpy(steps if exact else frame.colour), torch.from_numpy(frame.depth)
