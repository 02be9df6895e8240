"""The distances of a frame's points to the surface of the map, step by step.

A signed distance is nearly linear over a few millimetres. So the map is asked at the first step, and again only where the points have moved
farther than that. In between, distances are carried along their gradients.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.alignment.depth_term import DepthTerm, depth_term
from idfslam.alignment.frame_motion import FrameMotion, numbers_of
from idfslam.alignment.normals import smoothed_normals
from idfslam.alignment.surface import Surface
from idfslam.compute.backend import pick

# [m] Root mean square of the points' motion since the map was asked, up to which distances are linear. More: the map is asked less often,
# and distances near edges are less exact. Chosen by hand.
_LINEAR = 0.002

MapQuery = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Points (N, 3) [m] in the world -> signed distance (N,) [m] and its gradient (N, 3)."""


@dataclass(frozen=True)
class _Asked:
    """What the map has said of N points."""

    points: Tensor  # (N, 3) [m] in the world
    distance: Tensor  # (N,) [m]
    gradient: Tensor  # (N, 3)
    normal: Tensor  # (N, 3) smoothed
    slope: Tensor  # (N,) length of the gradient


class SurfaceDistances:
    """The points of a frame, whose distances to the map give normal equations of its pose."""

    def __init__(self, surface: Surface, query: MapQuery, truncation: float, widest: float) -> None:
        """truncation [m]: of the map. widest: the largest noise of a point, over the sensor's best, that widens the robust kernel [1]."""
        self.surface, self.query, self.truncation, self.widest = surface, query, truncation, widest
        self._asked: _Asked | None = None

    def term(self, T: Tensor, robust: float, motion: FrameMotion | None) -> DepthTerm:
        """The equations at a pose T (4, 4). robust [m]: scale of the robust kernel. motion: within the frame; with it, with moments."""
        turned, points = placed(self.surface, T, motion)
        asked, distance = self._distance(points, turned)
        rows = None if motion is None else self.surface.rows
        sigma = self.surface.sigma
        return depth_term(turned, distance, asked.normal, asked.slope, sigma, self.truncation, robust, self.widest, rows)

    def _distance(self, points: Tensor, turned: Tensor) -> tuple[_Asked, Tensor]:
        """What the map has said near points (N, 3) of the world, and their distances (N,). turned: the same from the camera's centre."""
        if self._asked is not None:
            squares, distance = carried_distance(points, self._asked.points, self._asked.distance, self._asked.gradient)
            if squares < _LINEAR**2 * len(points):
                return self._asked, distance
        distance, gradient = self.query(points)
        self._asked = _Asked(points, distance, gradient, *smoothed_normals(turned, gradient, self.surface.patches))
        return self._asked, distance


def placed(surface: Surface, T: Tensor, motion: FrameMotion | None) -> tuple[Tensor, Tensor]:
    """The points (N, 3) of a frame at a pose T (4, 4), from the camera's centre and in the world; both along world axes.

    motion: within the frame; with it, they are as at the frame's time stamp.
    """
    return pick(surface.points, compiled=compiled_placed, plain=plain_placed)(surface, T, motion)


def compiled_placed(surface: Surface, T: Tensor, motion: FrameMotion | None) -> tuple[Tensor, Tensor]:
    """`placed` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_alignment

    turned, points = torch.empty_like(surface.points), torch.empty_like(surface.points)
    inputs = surface.points.numpy(), surface.rows.numpy(), T.numpy(), *numbers_of(motion)
    numba_alignment.place(*inputs, turned.numpy(), points.numpy())  # type: ignore[call-arg]
    return turned, points


def plain_placed(surface: Surface, T: Tensor, motion: FrameMotion | None) -> tuple[Tensor, Tensor]:
    """`placed` in torch, on any device."""
    T = T.to(surface.points)
    turned = surface.points @ T[:3, :3].T
    if motion is not None:
        turned = motion.depth_at_stamp(turned, surface.rows)
    return turned, turned + T[:3, 3]


def carried_distance(points: Tensor, asked: Tensor, distance: Tensor, gradient: Tensor) -> tuple[float, Tensor]:
    """The sum [m^2] of the squares of the ways from `asked` (N, 3), where the map was asked, to points (N, 3), and their distances (N,).

    distance (N,) [m], gradient (N, 3): what the map has said there.
    """
    return pick(points, compiled=compiled_carried_distance, plain=plain_carried_distance)(points, asked, distance, gradient)


def compiled_carried_distance(points: Tensor, asked: Tensor, distance: Tensor, gradient: Tensor) -> tuple[float, Tensor]:
    """`carried_distance` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_alignment

    out = torch.empty_like(distance)
    arrays = points.numpy(), asked.numpy(), distance.numpy(), gradient.numpy()
    return numba_alignment.carry_distance(*arrays, out.numpy()), out  # type: ignore[call-arg]


def plain_carried_distance(points: Tensor, asked: Tensor, distance: Tensor, gradient: Tensor) -> tuple[float, Tensor]:
    """`carried_distance` in torch, on any device."""
    way = points - asked
    return float(way.square().sum()), distance + (way * gradient).sum(-1)
