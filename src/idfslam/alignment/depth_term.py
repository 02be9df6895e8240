"""The normal equations of a pose from the distances of a frame's points to the surface of the map, along the map's normals."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.alignment.constants import LEAST_SLOPE, MAPPED, SLOPE_FLOOR
from idfslam.alignment.row_moments import PoseEquations, RowMoments
from idfslam.compute.backend import pick


@dataclass(frozen=True)
class DepthTerm(PoseEquations):
    """The equations of the distances of a frame's points to the map."""

    weight: float  # sum of the robust weights
    overlap: float  # share of the points that take part
    rmse: float  # [m] of the distances, weighted by their noise
    noise: float  # RMS noise of the readings, weighted alike, relative to the sensor's best [1]
    radius: float  # mean distance of the points [m], by which a turn is compared with a shift

    @classmethod
    def absent(cls, *, weight: float, radius: float, moments: bool) -> "DepthTerm":
        """The term of a frame without depth. It says nothing; weight and radius [m] give the scale of what images say."""
        return cls(RowMoments.zeros(moments=moments), weight, 1.0, 0.0, 0.0, radius)


def depth_term(
    turned: Tensor,
    distance: Tensor,
    normal: Tensor,
    slope: Tensor,
    sigma: Tensor,
    truncation: float,
    robust: float,
    widest: float,
    rows: Tensor | None = None,
) -> DepthTerm:
    """Normal equations of the distances (N,) [m] of points to the map, along its normals (N, 3).

    turned (N, 3) [m]: the points from the camera's centre, along world axes. slope (N,): the length of the distance's gradient.
    sigma (N,): the noise relative to the sensor's best. robust [m]: scale of the robust kernel. widest: the largest sigma that widens it.
    rows (N,): the points' rows, for the moments; None: without them.
    """
    build = pick(turned, compiled=compiled_depth_term, plain=plain_depth_term)
    return build(turned, distance, normal, slope, sigma, truncation, robust, widest, rows)


def compiled_depth_term(
    turned: Tensor,
    distance: Tensor,
    normal: Tensor,
    slope: Tensor,
    sigma: Tensor,
    truncation: float,
    robust: float,
    widest: float,
    rows: Tensor | None = None,
) -> DepthTerm:
    """`depth_term` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_depth

    out = RowMoments.zeros(moments=rows is not None)
    arrays = [t.numpy() for t in (turned, distance, normal, slope, sigma, sigma if rows is None else rows)]
    sums = numba_depth.depth_system(*arrays, truncation, robust, widest, out.H, out.b)  # type: ignore[call-arg]
    return of_sums(out, sums, len(distance))


def of_sums(equations: RowMoments, sums: tuple[float, float, float, int, float], count: int) -> DepthTerm:
    """The term of `count` points, by what `numba_depth.depth_system` returns of them."""
    weight, squares, robustly, known, radius = sums
    per_weight = 1 / max(weight, 1e-9)
    return DepthTerm(equations, weight, known / count, math.sqrt(squares * per_weight), math.sqrt(robustly * per_weight), radius)


def plain_depth_term(
    turned: Tensor,
    distance: Tensor,
    normal: Tensor,
    slope: Tensor,
    sigma: Tensor,
    truncation: float,
    robust: float,
    widest: float,
    rows: Tensor | None = None,
) -> DepthTerm:
    """`depth_term` in torch, on any device."""
    mapped = (distance.abs() < MAPPED * truncation) & (slope > LEAST_SLOPE)
    r = distance / slope.clamp(min=SLOPE_FLOOR)
    J = torch.cat([normal, torch.linalg.cross(turned, normal)], -1)
    scale = robust * sigma.clamp(max=widest)
    kernel = mapped / (1 + (r / scale) ** 2) ** 2  # Geman-McClure
    w = kernel / sigma**2  # divided by the sensor's variance
    weight, squares = float(w.sum()), float((w * r * r).sum())
    rmse, noise = ((total / max(weight, 1e-9)) ** 0.5 for total in (squares, float(kernel.sum())))
    overlap = float(mapped.float().mean())
    return DepthTerm(RowMoments.of(J, w, r, rows), weight, overlap, rmse, noise, float(turned.norm(dim=-1).mean()))
