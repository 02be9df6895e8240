"""The distances of a frame's points to the surface of the map, step by step.

A signed distance is nearly linear over a few millimetres. So the map is asked at the first step, and again only where the points have moved
farther than that. In between, distances are carried along their gradients.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.alignment.depth_term import DepthTerm, of_sums, plain_depth_term
from idfslam.alignment.frame_motion import FrameMotion, numbers_of
from idfslam.alignment.normals import fill_smoothed_normals, plain_smoothed_normals
from idfslam.alignment.row_moments import RowMoments
from idfslam.alignment.surface import Surface
from idfslam.compute.backend import pick

Floats = NDArray[np.float32]

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

    @cached_property
    def arrays(self) -> tuple[Floats, ...]:
        """All of it, sharing memory."""
        return tuple(values.numpy() for values in (self.points, self.distance, self.gradient, self.normal, self.slope))


class _Arrays:
    """The points of a surface as arrays, and room for what each step fills. They are laid out once."""

    def __init__(self, surface: Surface) -> None:
        self.points, self.sigma, self.rows = (values.numpy() for values in (surface.points, surface.sigma, surface.rows))
        self.patches: NDArray[np.int32] = surface.patches.numpy()
        self.turned: Floats = np.empty_like(self.points)
        self.distance: Floats = np.empty_like(self.sigma)


class SurfaceDistances:
    """The points of a frame, whose distances to the map give normal equations of its pose."""

    def __init__(self, surface: Surface, query: MapQuery, truncation: float, widest: float) -> None:
        """truncation [m]: of the map. widest: the largest noise of a point, over the sensor's best, that widens the robust kernel [1]."""
        self.surface, self.query, self.truncation, self.widest = surface, query, truncation, widest
        self._asked: _Asked | None = None

    def term(self, T: Tensor, robust: float, motion: FrameMotion | None) -> DepthTerm:
        """The equations at a pose T (4, 4). robust [m]: scale of the robust kernel. motion: within the frame; with it, with moments."""
        return pick(self.surface.points, compiled=self._compiled_term, plain=self._plain_term)(T, robust, motion)

    def _plain_term(self, T: Tensor, robust: float, motion: FrameMotion | None) -> DepthTerm:
        """`term` in torch, on any device."""
        turned, points = _placed(self.surface, T, motion)
        asked, distance = self._asked, None if self._asked is None else _carried_distance(points, self._asked)
        if asked is None or distance is None:
            distance, gradient = self.query(points)
            asked = self._asked = _Asked(points, distance, gradient, *plain_smoothed_normals(turned, gradient, self.surface.patches))
        of_points = turned, distance, asked.normal, asked.slope, self.surface.sigma
        return plain_depth_term(*of_points, self.truncation, robust, self.widest, None if motion is None else self.surface.rows)

    def _compiled_term(self, T: Tensor, robust: float, motion: FrameMotion | None) -> DepthTerm:
        """`term` by Numba, on the CPU."""
        from idfslam.alignment.kernels import numba_depth

        a, points = self._arrays, np.empty_like(self._arrays.points)
        numba_depth.place(a.points, a.rows, T.numpy(), *numbers_of(motion), a.turned, points)  # type: ignore[call-arg]
        asked = self._asked
        if asked is None or numba_depth.carry_distance(points, *asked.arrays[:3], a.distance) >= _LINEAR**2 * len(points):  # type: ignore[call-arg]
            distance, gradient = self.query(torch.from_numpy(points))
            normal, slope = fill_smoothed_normals(a.turned, gradient.numpy(), a.patches)
            asked = self._asked = _Asked(torch.from_numpy(points), distance, gradient, torch.from_numpy(normal), torch.from_numpy(slope))
            a.distance[:] = asked.arrays[1]
        sums = RowMoments.zeros(moments=motion is not None)
        limits = self.truncation, robust, self.widest
        found = numba_depth.depth_system(a.turned, a.distance, *asked.arrays[3:], a.sigma, a.rows, *limits, sums.H, sums.b)  # type: ignore[call-arg]
        return of_sums(sums, found, len(points))

    @cached_property
    def _arrays(self) -> _Arrays:
        return _Arrays(self.surface)


def _placed(surface: Surface, T: Tensor, motion: FrameMotion | None) -> tuple[Tensor, Tensor]:
    """The points (N, 3) of a frame at a pose T (4, 4), from the camera's centre and in the world; both along world axes.

    motion: within the frame; with it, they are as at the frame's time stamp.
    """
    T = T.to(surface.points)
    turned = surface.points @ T[:3, :3].T
    if motion is not None:
        turned = motion.depth_at_stamp(turned, surface.rows)
    return turned, turned + T[:3, 3]


def _carried_distance(points: Tensor, asked: _Asked) -> Tensor | None:
    """The distances (N,) of points (N, 3) that have moved since the map was asked; None if they have moved too far."""
    way = points - asked.points
    return None if float(way.square().sum()) >= _LINEAR**2 * len(points) else asked.distance + (way * asked.gradient).sum(-1)
