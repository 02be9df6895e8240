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

from idfslam.alignment.constants import LEAST_GRADIENT
from idfslam.alignment.frame_motion import FrameMotion
from idfslam.alignment.landmarks import Landmarks
from idfslam.alignment.sighting import Appearance, Sighting, masked
from idfslam.alignment.uneven_light import plain_relit
from idfslam.compute.backend import pick

# Rows of the image that displacements are measured on. More: smaller errors show, and blur and noise pass for errors.
# Chosen by hand on generated hand-held recordings and fr1/rpy: with 120 and 30 rows right and wrong poses are told apart less well.
_ROWS = 60


def level_of(frame: Appearance, rows: int = _ROWS) -> int:
    """The level of a frame's pyramid with about so many rows; default: that on which displacements are measured."""
    return min(range(len(frame.levels)), key=lambda level: abs(math.log(frame.levels[level].camera.height / rows)))


def displacement(frame: Appearance, marks: Landmarks, T_wk: Tensor, T_wc: Tensor, motion: FrameMotion | None = None) -> tuple[int, float]:
    """The number of a keyframe's landmarks within a frame at `T_wc`, and their median displacement [rad]; poses (4, 4) float64.

    Differences of exposure and light are taken out. The displacement is 0 if no landmark lies within the frame. motion: of the camera
    within it.
    """
    sighting = Sighting(frame, marks, T_wk, T_wc, level_of(frame), motion)
    seen, pixels = pick(marks.points, compiled=compiled_displacement, plain=plain_displacement)(sighting)
    return seen, pixels / sighting.image.camera.fx


def compiled_displacement(sighting: Sighting) -> tuple[int, float]:
    """Number of landmarks and their median displacement [px], by Numba, on the CPU."""
    from idfslam.alignment.kernels.numba_landmarks import median_displacement

    marks, level = sighting.marks, sighting.level
    landmarks = marks.points.numpy(), marks.luminance[level].numpy(), marks.slopes[level].numpy()
    seen, pixels = median_displacement(*landmarks, *sighting.numbers())
    return int(seen), float(pixels)


def plain_displacement(sighting: Sighting) -> tuple[int, float]:
    """The same in torch, on any device."""
    image, level, marks, places = sighting.image, sighting.level, sighting.marks, sighting.places()
    inside = places.within & ~masked(sighting.frame, places.uv, image.camera)
    seen = inside & places.in_sight
    if not bool(inside.any()):
        return 0, 0.0
    value, *slopes = image.at(places.uv)
    means = [(of_frame + of_keyframe) / 2 for of_frame, of_keyframe in zip(slopes, marks.slopes[level])]
    relit = plain_relit(*(x[seen] for x in (marks.luminance[level], value, *means, sighting.shares(places.uv))))
    du, dv = ((of_frame[seen] + relit.gain * of_keyframe[seen]) / 2 for of_frame, of_keyframe in zip(slopes, marks.slopes[level]))
    off = relit.difference.abs() / torch.hypot(du, dv).clamp(min=LEAST_GRADIENT)
    displaced = torch.full_like(value, image.camera.width).masked_scatter(seen, off.clamp(max=image.camera.width))
    return int(inside.sum()), float(displaced[inside].quantile(0.5))
