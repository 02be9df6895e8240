"""The displacement of an image that would explain how its brightness differs from that of keyframes.

A landmark whose brightness differs by r, where the image has the gradient g, lies about |r| / |g| pixels off (optical flow: Lucas and
Kanade 1981). g is the mean of the gradients in both images (Malis 2004: then this is exact to second order). A landmark whose depth
contradicts the frame's lies farther off than any other; one that is hidden by what moves says nothing. At a wrong pose all landmarks lie
off, so their median is large. It is taken on a coarse image: blur and noise are gone there, and an error of two degrees is still larger
than a pixel.
"""

import math

import torch
from torch import Tensor

from idfslam.alignment.constants import LEAST_GRADIENT, NEAREST
from idfslam.alignment.frame_motion import FrameMotion, numbers_of
from idfslam.alignment.landmarks import Landmarks
from idfslam.alignment.photometric import Appearance, at_their_rows, exposure, masked, unoccluded
from idfslam.compute.backend import pick
from idfslam.geometry import se3

# Rows of the image that displacements are measured on. More: smaller errors show, and blur and noise pass for errors.
# Chosen by hand on generated hand-held recordings and fr1/rpy: with 120 and 30 rows right and wrong poses are told apart less well.
_ROWS = 60


def level_of(frame: Appearance, rows: int = _ROWS) -> int:
    """The level of a frame's pyramid with about so many rows; default: that on which displacements are measured."""
    return min(range(len(frame.levels)), key=lambda level: abs(math.log(frame.levels[level].camera.height / rows)))


def displacement(frame: Appearance, marks: Landmarks, T_wk: Tensor, T_wc: Tensor, motion: FrameMotion | None = None) -> tuple[int, float]:
    """The number of a keyframe's landmarks within a frame at `T_wc`, and their median displacement [rad]; poses (4, 4) float64.

    Differences of exposure are taken out. The displacement is 0 if no landmark lies within the frame. motion: of the camera within it.
    """
    level = level_of(frame)
    measure = pick(marks.points, compiled=compiled_displacement, plain=plain_displacement)
    seen, pixels = measure(frame, marks, T_wk, T_wc, level, motion)
    return seen, pixels / frame.levels[level].camera.fx


def compiled_displacement(
    frame: Appearance, marks: Landmarks, T_wk: Tensor, T_wc: Tensor, level: int, motion: FrameMotion | None = None
) -> tuple[int, float]:
    """Number of landmarks and their median displacement [px], by Numba, on the CPU."""
    from idfslam.alignment.kernels.numba_alignment import median_displacement

    image, camera = frame.levels[level].luminance, frame.levels[level].camera
    ratio = frame.camera.width / camera.width, frame.camera.height / camera.height
    seen, pixels = median_displacement(
        marks.points.numpy(), marks.luminance[level].numpy(), marks.slopes[level].numpy(), T_wk.numpy(), T_wc.numpy(), *numbers_of(motion),
        image.numpy(), camera.fx, camera.fy, camera.cx, camera.cy, frame.depth.numpy(), *ratio,
    )  # fmt: skip
    return int(seen), float(pixels)


def plain_displacement(
    frame: Appearance, marks: Landmarks, T_wk: Tensor, T_wc: Tensor, level: int, motion: FrameMotion | None = None
) -> tuple[int, float]:
    """The same in torch, on any device."""
    T_wk, T_wc = T_wk.to(marks.points), T_wc.to(marks.points)
    image, d = frame.levels[level], se3.transform(T_wk, marks.points) - T_wc[:3, 3]
    d, depth_points = (d, d) if motion is None else at_their_rows(d, motion, T_wc, image.camera)
    uv, z = image.camera.project(d @ T_wc[:3, :3])
    size = uv.new_tensor([image.camera.width - 2, image.camera.height - 2])
    inside = (z >= NEAREST) & (uv >= 1).all(-1) & (uv <= size).all(-1) & ~masked(frame, uv, image.camera)
    seen = inside & unoccluded(frame, *image.camera.project(depth_points @ T_wc[:3, :3]), image.camera)
    if not bool(inside.any()):
        return 0, 0.0
    value, *slopes = image.at(uv)
    gain, offset = exposure(marks.luminance[level], value, seen)
    du, dv = ((of_frame + gain * of_keyframe) / 2 for of_frame, of_keyframe in zip(slopes, marks.slopes[level]))
    off = (value - gain * marks.luminance[level] - offset).abs() / torch.hypot(du, dv).clamp(min=LEAST_GRADIENT)
    widest = float(image.camera.width)
    return int(inside.sum()), float(off.clamp(max=widest).where(seen, off.new_tensor(widest))[inside].quantile(0.5))
