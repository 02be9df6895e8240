"""What the tracker extracts from a frame: images at the tracker's resolution, points, and the trunk's features."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.tracking.patches import Patches, chosen_patches

# All of these were chosen by hand.
_ONE_SURFACE = 0.03  # [1] largest relative difference of depths on one surface. More: depth is averaged over edges
_NORMAL_REACH = 2  # [px] distance to the neighbours that a normal is computed from. More: smoother normals, missing nearer to edges
_IMAGE_ROWS = 480  # [px] most rows of the image that patches are aligned in. More: finer matches, and more time and memory a frame
_COARSEST_ROWS = 100  # [px] least rows of the coarsest image of the pyramid. More: fewer levels, and smaller errors are corrected
_NORMAL_EDGE = 0.1  # [1] largest relative difference of depth between these neighbours. More: normals are computed over edges


@dataclass(frozen=True)
class FrameFeatures:
    """The features of a frame at the tracker's resolution (h, w).

    The trunk's output is kept rather than the final features, so that a finetuned out-conv applies to stored keyframes too.
    """

    trunk: Tensor  # (64, h, w)
    colour: Tensor  # (3, h, w) in [0, 1]
    points: Tensor  # (h, w, 3) in the camera's frame [m]; z = 0: no depth
    camera: Camera  # of the (h, w) image
    source: Camera  # of the recording's image
    grey: Tensor = field(default_factory=lambda: torch.zeros(0, 0, dtype=torch.uint8))  # (H, W) brightness, finer than h x w; on the CPU

    @property
    def grey_camera(self) -> Camera:
        """The camera of `grey`; that of the recording if there is no such image."""
        return self.source.resized(self.grey.shape[1], self.grey.shape[0]) if self.grey.numel() else self.source

    @property
    def are_images_alone(self) -> bool:
        """Whether no features were extracted."""
        return self.trunk.numel() == 0

    @property
    def valid(self) -> Tensor:
        """(h, w) bool: pixels with depth."""
        return self.points[..., 2] > 0

    @cached_property
    def pyramid(self) -> list[Tensor]:
        """`grey` and its halves, down to about the features' resolution: pixel (u, v) of one is pixel (u, v) / 2 of the next."""
        levels: list[NDArray[np.uint8]] = [self.grey.numpy()]
        while levels[-1].shape[0] >= 2 * _COARSEST_ROWS:
            levels.append(cv2.pyrDown(levels[-1]).astype(np.uint8, copy=False))
        return [torch.from_numpy(level) for level in levels]

    @cached_property
    def patches(self) -> Patches:
        """Patches of `grey` that other frames are compared with."""
        return chosen_patches(self.grey, self.points.cpu(), self.normals.cpu(), self.grey_camera)

    @cached_property
    def normals(self) -> Tensor:
        """(h, w, 3) unit normals of the points, towards the camera; zero where there is none."""
        return surface_normals(self.points)

    def packed(self) -> tuple[list[Tensor], Callable[[Sequence[Tensor]], "FrameFeatures"]]:
        """The tensors in their memory order (channels last), and a function that makes the same features of them again."""
        camera, source, device = self.camera, self.source, self.points.device

        def unpacked(tensors: Sequence[Tensor]) -> FrameFeatures:
            trunk, colour, points = (tensor.to(device) for tensor in tensors[:3])
            return FrameFeatures(trunk.permute(2, 0, 1), colour.permute(2, 0, 1), points, camera, source, tensors[3])

        return [self.trunk.permute(1, 2, 0), self.colour.permute(1, 2, 0), self.points, self.grey], unpacked


def reduced(frame: Frame, height: int) -> tuple[NDArray[np.float32], NDArray[np.float32], Camera]:
    """Colour (h, w, 3), depth (h, w) [m] and camera of a frame reduced to `height` rows. A frame is never enlarged."""
    h = min(height, frame.camera.height)
    w = round(frame.camera.width * h / frame.camera.height)
    colour = cv2.resize(frame.colour, (w, h), interpolation=cv2.INTER_AREA)
    return colour.astype(np.float32, copy=False), averaged_depth(frame.depth, h, w), frame.camera.resized(w, h)


def brightness(frame: Frame) -> NDArray[np.uint8]:
    """The brightness (H, W) of a frame's colour image, of at most `_IMAGE_ROWS` rows."""
    colour: NDArray[Any] = frame.colour
    if (size := grey_size(frame.camera)) != colour.shape[:2]:
        colour = cv2.resize(colour, size[::-1], interpolation=cv2.INTER_AREA)
    grey = cv2.cvtColor(colour.astype(np.float32, copy=False), cv2.COLOR_RGB2GRAY)
    return cv2.convertScaleAbs(grey, alpha=255.0).astype(np.uint8, copy=False)


def grey_size(camera: Camera) -> tuple[int, int]:
    """Rows and columns of `brightness`."""
    rows = min(camera.height, _IMAGE_ROWS)
    return rows, round(camera.width * rows / camera.height)


def averaged_depth(depth: NDArray[np.float32], height: int, width: int) -> NDArray[np.float32]:
    """Depth (H, W) reduced to (height, width): the mean of the readings under each pixel, if they lie on one surface.

    If the mean differs from the reading at the centre by more than 3 %, an edge runs through the pixel, and the reading at the centre is
    taken.
    """
    share = cv2.resize((depth > 0).astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    mean = cv2.resize(depth, (width, height), interpolation=cv2.INTER_AREA) / np.maximum(share, 1e-6)
    centre = subsampled_depth(depth, height, width)
    return np.where(np.abs(mean - centre) < _ONE_SURFACE * centre, mean, centre).astype(np.float32)


def subsampled_depth(depth: NDArray[np.float32], height: int, width: int) -> NDArray[np.float32]:
    """Depth (H, W) at the pixel centres of a (height, width) image. A missing reading is taken from a neighbour, never averaged."""
    rows = ((np.arange(height) + 0.5) * depth.shape[0] / height).astype(int)
    columns = ((np.arange(width) + 0.5) * depth.shape[1] / width).astype(int)
    out = depth[np.ix_(rows, columns)]
    for up, left in ((1, 0), (0, 1), (1, 1)):
        neighbour = depth[np.ix_(np.maximum(rows - up, 0), np.maximum(columns - left, 0))]
        out = np.where(out > 0, out, neighbour)
    return out


def surface_normals(points: Tensor) -> Tensor:
    """Unit normals (h, w, 3) of an image of points (h, w, 3) [m], towards the camera; zero at borders, holes and edges of depth."""
    k = _NORMAL_REACH
    middle, left, right = points[k:-k, k:-k], points[k:-k, : -2 * k], points[k:-k, 2 * k :]
    up, down = points[: -2 * k, k:-k], points[2 * k :, k:-k]
    measured = torch.stack([p[..., 2] for p in (middle, left, right, up, down)]).amin(0) > 0
    across, along = right - left, down - up
    smooth = torch.maximum(across[..., 2].abs(), along[..., 2].abs()) < _NORMAL_EDGE * middle[..., 2]
    normals = torch.zeros_like(points)
    normals[k:-k, k:-k] = F.normalize(torch.linalg.cross(along, across), dim=-1) * (measured & smooth)[..., None]
    return normals
