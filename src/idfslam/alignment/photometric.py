"""Direct photometric alignment: landmarks of a keyframe have the same brightness in the frame.

The images of earlier keyframes constrain directions that the shape of the map leaves open (along a bare wall), to a fraction of a pixel.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.alignment.constants import (
    DEVIATION,
    LARGEST_GAIN,
    LEAST_GAIN,
    LEAST_SPREAD,
    MASKED,
    NEAREST,
    OCCLUSION,
    OCCLUSION_SHARE,
    ROW_STEPS,
)
from idfslam.alignment.frame_motion import FrameMotion, numbers_of
from idfslam.alignment.image_pyramid import Level
from idfslam.alignment.landmarks import Landmarks
from idfslam.alignment.row_moments import PoseEquations, RowMoments
from idfslam.compute.backend import pick
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera


@dataclass(frozen=True)
class Appearance:
    """A frame's image and depth, with which landmarks are compared."""

    levels: list[Level]
    depth: Tensor  # (H, W) [m]; MASKED where the frame shows what moves
    camera: Camera  # of the depth


@dataclass(frozen=True)
class Term(PoseEquations):
    """The equations of the brightness of one keyframe's landmarks."""

    seen: int  # landmarks in view
    noise: float  # scale of the brightness differences [1]


def photometric_term(
    frame: Appearance,
    marks: Landmarks,
    T_wk: Tensor,
    T_wc: Tensor,
    level: int,
    *,
    floor: float,
    widest: float,
    moments: bool = False,
    motion: FrameMotion | None = None,
) -> Term:
    """Normal equations of the brightness differences of a keyframe's landmarks in a frame at `T_wc`, after exposure is compensated.

    Differences are divided by their own scale, so that sharp, well-registered images count more than blurred ones. The scale comes from
    their median and is at least `floor` [1]. The robust kernel has a width of `widest` scales. Poses are (4, 4) float64.
    moments: whether the sums have the moments of the rows. motion: of the camera within the frame, whose rows have times of their own.
    """
    term = pick(marks.points, compiled=compiled_photometric_term, plain=plain_photometric_term)
    return term(frame, marks, T_wk, T_wc, level, floor=floor, widest=widest, moments=moments, motion=motion)


def compiled_photometric_term(
    frame: Appearance,
    marks: Landmarks,
    T_wk: Tensor,
    T_wc: Tensor,
    level: int,
    *,
    floor: float,
    widest: float,
    moments: bool = False,
    motion: FrameMotion | None = None,
) -> Term:
    """`photometric_term` by Numba, on the CPU."""
    from idfslam.alignment.kernels.numba_alignment import photometric_system

    image, camera = frame.levels[level].luminance, frame.levels[level].camera
    sums = RowMoments.zeros(moments=moments)
    ratio = frame.camera.width / camera.width, frame.camera.height / camera.height
    seen, noise = photometric_system(
        marks.points.numpy(), marks.luminance[level].numpy(), T_wk.numpy(), T_wc.numpy(), *numbers_of(motion),
        image.numpy(), camera.fx, camera.fy, camera.cx, camera.cy, frame.depth.numpy(), *ratio, floor, widest,
        sums.H, sums.b,
    )  # fmt: skip
    return Term(sums, seen, noise)


def plain_photometric_term(
    frame: Appearance,
    marks: Landmarks,
    T_wk: Tensor,
    T_wc: Tensor,
    level: int,
    *,
    floor: float,
    widest: float,
    moments: bool = False,
    motion: FrameMotion | None = None,
) -> Term:
    """`photometric_term` in torch, on any device."""
    T_wk, T_wc = T_wk.to(marks.points), T_wc.to(marks.points)
    d = se3.transform(T_wk, marks.points) - T_wc[:3, 3]  # from the camera's centre, world axes
    image = frame.levels[level]
    d, depth_points = (d, d) if motion is None else at_their_rows(d, motion, T_wc, image.camera)
    points_c = d @ T_wc[:3, :3]
    uv, z = image.camera.project(points_c)
    in_sight = unoccluded(frame, *image.camera.project(depth_points @ T_wc[:3, :3]), image.camera)
    value, slope_u, slope_v = image.at(uv)
    target = marks.luminance[level]
    size = uv.new_tensor([image.camera.width - 2, image.camera.height - 2])
    inside = (z >= NEAREST) & (uv >= 1).all(-1) & (uv <= size).all(-1) & in_sight
    gain, offset = exposure(target, value, inside)
    r = value - gain * target - offset
    scale = _median(r.abs()[inside]).mul(DEVIATION).clamp(min=floor)
    w = inside / ((1 + (r / (widest * scale)) ** 2) ** 2 * scale**2)
    # dr = -slope . dpi/dp . R^T (shift + turn x d)
    fx, fy = image.camera.fx, image.camera.fy
    x, y, _ = points_c.unbind(-1)
    z = z.clamp(min=NEAREST)
    a = torch.stack([slope_u * fx / z, slope_v * fy / z, -(slope_u * fx * x + slope_v * fy * y) / z**2], -1)
    n = -(a @ T_wc[:3, :3].T)
    J = torch.cat([n, torch.linalg.cross(d, n)], -1)
    rows = (uv[:, 1] + 0.5) / image.camera.height - 0.5 if moments else None
    return Term(RowMoments.of(J, w, r, rows), int(inside.sum()), float(scale))


def at_their_rows(d: Tensor, motion: FrameMotion, T_wc: Tensor, camera: Camera) -> tuple[Tensor, Tensor]:
    """Points (N, 3) from the camera's centre along world axes, as the rows of colour see them, and as those of depth do."""
    seen = d
    for _ in range(ROW_STEPS):
        seen = motion.colour_at_rows(d, _rows(seen @ T_wc[:3, :3], camera))
    return seen, motion.depth_at_rows(d, _rows(seen @ T_wc[:3, :3], camera))


def _rows(points_c: Tensor, camera: Camera) -> Tensor:
    """The rows (N,), from -0.5 to 0.5, in which points (N, 3) are seen."""
    return ((camera.project(points_c)[0][:, 1] + 0.5) / camera.height - 0.5).clamp(-0.5, 0.5)


def _median(values: Tensor) -> Tensor:
    """The median, as numpy computes it: the middle two are averaged. 0 for no values."""
    return values.quantile(0.5) if len(values) else values.new_zeros(())


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


def exposure(target: Tensor, value: Tensor, inside: Tensor) -> tuple[Tensor, Tensor]:
    """Gain and offset with value = gain * target + offset over the landmarks in view, from means and standard deviations."""
    n = inside.sum().clamp(min=1)
    mean_t, mean_v = (target * inside).sum() / n, (value * inside).sum() / n
    spread_t = (((target - mean_t) ** 2 * inside).sum() / n).sqrt()
    spread_v = (((value - mean_v) ** 2 * inside).sum() / n).sqrt()
    gain = (spread_v / spread_t.clamp(min=LEAST_SPREAD)).clamp(LEAST_GAIN, LARGEST_GAIN)
    return gain, mean_v - gain * mean_t
