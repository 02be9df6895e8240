"""Where a frame would show the landmarks of a keyframe, and whether anything hides them there."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from idfslam.alignment.constants import MASKED, NEAREST, OCCLUSION, OCCLUSION_SHARE, ROW_STEPS
from idfslam.alignment.frame_motion import FrameMotion, numbers_of
from idfslam.alignment.image_pyramid import Level
from idfslam.alignment.landmarks import Landmarks
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera


@dataclass(frozen=True)
class Appearance:
    """A frame's image and depth, with which landmarks are compared."""

    levels: list[Level]
    depth: Tensor  # (H, W) [m]; MASKED where the frame shows what moves
    camera: Camera  # of the depth

    @cached_property
    def numbers(self) -> list[tuple[Any, ...]]:
        """Each level with the depth, for compiled loops: they are called for many landmarks of one image."""
        return [self._numbers(level) for level in self.levels]

    def _numbers(self, level: Level) -> tuple[Any, ...]:
        camera, of_depth = level.camera, self.camera
        ratio = of_depth.width / camera.width, of_depth.height / camera.height
        return level.luminance.numpy(), camera.fx, camera.fy, camera.cx, camera.cy, self.depth.numpy(), *ratio


@dataclass(frozen=True)
class Places:
    """Where a level of a frame's pyramid would show landmarks."""

    d: Tensor  # (M, 3) [m] from the camera's centre, along world axes, as the rows of colour see them
    camera: Tensor  # (M, 3) [m] the same along the camera's axes
    uv: Tensor  # (M, 2) [px]
    z: Tensor  # (M,) [m]
    within: Tensor  # (M,) whether they lie within the image
    in_sight: Tensor  # (M,) whether nothing is in front of them


@dataclass(frozen=True)
class Sighting:
    """The landmarks of a keyframe at T_wk, and a level of the pyramid of a frame at T_wc; poses (4, 4) float64.

    motion: of the camera within the frame, whose rows have times of their own.
    """

    frame: Appearance
    marks: Landmarks
    T_wk: Tensor
    T_wc: Tensor
    level: int
    motion: FrameMotion | None = None

    @property
    def image(self) -> Level:
        """The level."""
        return self.frame.levels[self.level]

    def numbers(self) -> tuple[Any, ...]:
        """All but the landmarks, for compiled loops."""
        return self.T_wk.numpy(), self.T_wc.numpy(), *numbers_of(self.motion), *self.frame.numbers[self.level]

    def shares(self, uv: Tensor) -> Tensor:
        """(M, 3) column and row of landmarks at pixels (M, 2) of the image, and their row in that of the keyframe, each from 0 to 1."""
        of_keyframe = self.image.shares(self.image.camera.project(self.marks.points)[0])[:, 1:].clamp(0, 1)
        return torch.cat([self.image.shares(uv), of_keyframe], -1)

    def places(self) -> Places:
        """Where the landmarks are, in torch, on any device."""
        points, camera = self.marks.points, self.image.camera
        T_wk, T_wc = self.T_wk.to(points), self.T_wc.to(points)
        d = se3.transform(T_wk, points) - T_wc[:3, 3]
        d, of_depth = (d, d) if self.motion is None else at_their_rows(d, self.motion, T_wc, camera)
        points_c = d @ T_wc[:3, :3]
        uv, z = camera.project(points_c)
        size = uv.new_tensor([camera.width - 2, camera.height - 2])
        within = (z >= NEAREST) & (uv >= 1).all(-1) & (uv <= size).all(-1)
        return Places(d, points_c, uv, z, within, unoccluded(self.frame, *camera.project(of_depth @ T_wc[:3, :3]), camera))


def at_their_rows(d: Tensor, motion: FrameMotion, T_wc: Tensor, camera: Camera) -> tuple[Tensor, Tensor]:
    """Points (N, 3) from the camera's centre along world axes, as the rows of colour see them, and as those of depth do."""
    seen = d
    for _ in range(ROW_STEPS):
        seen = motion.colour_at_rows(d, _rows(seen @ T_wc[:3, :3], camera))
    return seen, motion.depth_at_rows(d, _rows(seen @ T_wc[:3, :3], camera))


def _rows(points_c: Tensor, camera: Camera) -> Tensor:
    """The rows (N,), from -0.5 to 0.5, in which points (N, 3) are seen."""
    return ((camera.project(points_c)[0][:, 1] + 0.5) / camera.height - 0.5).clamp(-0.5, 0.5)


def unoccluded(frame: Appearance, uv: Tensor, z: Tensor, camera: Camera) -> Tensor:
    """Whether a landmark's depth z agrees with the frame's own depth at its pixel, or the frame has none there."""
    depth = _depth_at(frame, uv, camera)
    return (depth <= 0) | ((depth - z).abs() < OCCLUSION + OCCLUSION_SHARE * z)


def masked(frame: Appearance, uv: Tensor, camera: Camera) -> Tensor:
    """Whether pixels (N, 2) of an image of this camera show what moves."""
    depth = _depth_at(frame, uv, camera)
    return (depth > 0) & (depth <= MASKED)


def _depth_at(frame: Appearance, uv: Tensor, camera: Camera) -> Tensor:
    """The frame's own depth (N,) [m] at pixels (N, 2) of an image of this camera."""
    u = ((uv[:, 0] + 0.5) * (frame.camera.width / camera.width)).long().clamp(0, frame.camera.width - 1)
    v = ((uv[:, 1] + 0.5) * (frame.camera.height / camera.height)).long().clamp(0, frame.camera.height - 1)
    return frame.depth[v, u]
