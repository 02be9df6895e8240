"""Direct photometric alignment: landmarks of a keyframe have the same brightness in the frame.

The images of earlier keyframes constrain directions that the shape of the map leaves open (along a bare wall), to a fraction of a pixel.
An image pyramid, used from the coarsest level on, widens the range of convergence.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
import torch.nn.functional as F
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
from idfslam.alignment.frame_motion import FrameMotion
from idfslam.alignment.row_moments import PoseEquations, RowMoments
from idfslam.compute.backend import pick
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.sensing.depth_edges import EDGE, EDGE_SHARE
from idfslam.sensing.vignette import Vignette


@dataclass(frozen=True)
class Level:
    """One level of an image pyramid."""

    luminance: Tensor  # (h, w) in [0, 1]
    camera: Camera

    def at(self, uv: Tensor) -> Tensor:
        """Luminance and its derivatives along u and v [1/px] at pixels (N, 2), bilinear: (3, N). Outside, those of the nearest border."""
        return self._sampled(with_slopes(self.luminance), uv)

    def luminance_at(self, uv: Tensor) -> Tensor:
        """Luminance (N,) at pixels (N, 2), as `at` gives it."""
        return self._sampled(self.luminance[None], uv)[0]

    def _sampled(self, channels: Tensor, uv: Tensor) -> Tensor:
        size = uv.new_tensor([self.camera.width, self.camera.height])
        place = ((uv + 0.5) * (2 / size) - 1)[None, None]
        return F.grid_sample(channels[None], place, align_corners=False, padding_mode="border")[0, :, 0]


def pyramid(colour: Tensor, camera: Camera, *, height: int, levels: int, vignette: Vignette | None = None) -> list[Level]:
    """The luminance pyramid of an image (H, W, 3), finest level first. That has at least `height` rows, each next one half as many.

    vignette: is taken out of the image.
    """
    full = luminance(colour)
    if vignette is not None:
        full = full / vignette.image(camera).to(full)
    shrink = max(1, camera.height // height)
    out: list[Level] = []
    for _ in range(levels):
        finer = out[-1].luminance if out else full
        halved = bool(out) and finer.shape[0] % 2 == 0 and finer.shape[1] % 2 == 0  # a mean of equally many pixels' means is their mean
        image = half(finer) if halved else F.avg_pool2d(full[None], shrink)[0] if shrink > 1 else full
        out.append(Level(image, camera.resized(image.shape[1], image.shape[0])))
        shrink *= 2
    return out


def half(image: Tensor) -> Tensor:
    """(h, w), both even, -> (h / 2, w / 2): the means of 2 x 2 pixels."""
    return pick(image, compiled=opencv_half, plain=plain_half)(image)


def plain_half(image: Tensor) -> Tensor:
    """`half` in torch, on any device."""
    return F.avg_pool2d(image[None], 2)[0]


def opencv_half(image: Tensor) -> Tensor:
    """`half` by OpenCV, on the CPU."""
    return torch.from_numpy(cv2.resize(image.numpy(), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))


def luminance(colour: Tensor) -> Tensor:
    """(H, W, 3) -> (H, W): the mean of the three channels."""
    return pick(colour, compiled=compiled_luminance, plain=plain_luminance)(colour)


def plain_luminance(colour: Tensor) -> Tensor:
    """`luminance` in torch, on any device."""
    return colour.mean(-1)


def compiled_luminance(colour: Tensor) -> Tensor:
    """`luminance` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_alignment

    out = torch.empty(colour.shape[:2])
    numba_alignment.luminance_of(colour.numpy(), out.numpy())  # type: ignore[call-arg]
    return out


def with_slopes(image: Tensor) -> Tensor:
    """(h, w) -> (3, h, w): the image and its central differences along u and v; zero at the border."""
    out = image.new_zeros(3, *image.shape)
    out[0] = image
    out[1, :, 1:-1] = (image[:, 2:] - image[:, :-2]) / 2
    out[2, 1:-1] = (image[2:] - image[:-2]) / 2
    return out


@dataclass(frozen=True)
class Landmarks:
    """Points of a keyframe with a strong image gradient, spread over the image."""

    points: Tensor  # (M, 3) [m] in the keyframe's frame
    luminance: list[Tensor]  # (M,) for each level of the pyramid
    slopes: list[Tensor]  # (2, M) derivatives of the luminance along u and v [1/px] for each level


def landmarks(levels: list[Level], depth: Tensor, *, count: int, least: float = 0.025) -> Landmarks:
    """About `count` landmarks: the pixel with the largest gradient in each cell of the finest level.

    A landmark has depth, no edge of the depth beside it, and a gradient above `least` [1/px].
    """
    fine = levels[0]
    measured = fine.camera.height * fine.camera.width * float((depth > 0).float().mean())
    cell = max(2, round((measured / count) ** 0.5))
    u, v = pick(depth, compiled=compiled_steepest, plain=plain_steepest)(fine, depth, cell, least)
    row, column = pixels_in_depth(fine, depth)
    points = fine.camera.rays(torch.stack([u, v], -1).to(depth.dtype)) * depth[row[v], column[u]][:, None]
    seen = [level.at(level.camera.project(points)[0]) for level in levels]
    return Landmarks(points, [values[0].contiguous() for values in seen], [values[1:].contiguous() for values in seen])


def plain_steepest(fine: Level, depth: Tensor, cell: int, least: float) -> tuple[Tensor, Tensor]:
    """u (M,) and v (M,) of the pixel with the largest gradient of each cell, in torch, on any device."""
    h, w = fine.camera.height // cell * cell, fine.camera.width // cell * cell
    slope = with_slopes(fine.luminance)[1:].norm(dim=0)
    row, column = pixels_in_depth(fine, depth)
    z = depth[row[:, None], column[None]]
    nearest, farthest = -F.max_pool2d(-z[None], 3, 1, 1)[0], F.max_pool2d(z[None], 3, 1, 1)[0]
    slope = slope * ((nearest > 0) & (farthest - nearest < EDGE + EDGE_SHARE * nearest))
    cells = slope[:h, :w].reshape(h // cell, cell, w // cell, cell).transpose(1, 2).reshape(-1, cell * cell)
    best, place = cells.max(1)
    index = torch.nonzero(best > least).flatten()
    v = index // (w // cell) * cell + place[index] // cell
    u = index % (w // cell) * cell + place[index] % cell
    return u, v


def compiled_steepest(fine: Level, depth: Tensor, cell: int, least: float) -> tuple[Tensor, Tensor]:
    """`plain_steepest` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_alignment

    most = (fine.camera.height // cell) * (fine.camera.width // cell)
    u, v = torch.empty(most, dtype=torch.int64), torch.empty(most, dtype=torch.int64)
    count = numba_alignment.steepest(fine.luminance.numpy(), depth.numpy(), cell, np.float32(least), u.numpy(), v.numpy())  # type: ignore[call-arg]
    return u[:count], v[:count]


def pixels_in_depth(fine: Level, depth: Tensor) -> tuple[Tensor, Tensor]:
    """The row of a depth image (H, W) in which each row of a level lies, and the column for each of its columns."""
    row = ((torch.arange(fine.camera.height, device=depth.device) + 0.5) * depth.shape[0] / fine.camera.height).long()
    column = ((torch.arange(fine.camera.width, device=depth.device) + 0.5) * depth.shape[1] / fine.camera.width).long()
    return row, column


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
    times, velocity = (np.zeros(3), np.zeros(6)) if motion is None else (motion.times.array, motion.velocity)
    seen, noise = photometric_system(
        marks.points.numpy(), marks.luminance[level].numpy(), T_wk.numpy(), T_wc.numpy(), times, velocity,
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
