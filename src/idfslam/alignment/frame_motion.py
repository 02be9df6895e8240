"""The motion of a camera within a frame: rows of a rolling shutter, and depth of another moment, see it at other places.

A camera with a constant velocity within the frame is displaced by exp(s velocity) s seconds after the frame's time stamp. The exponential
is taken to second order: the rest is below a hundredth of a pixel.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.compute.backend import pick
from idfslam.sensing.rectification import RowTimes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FrameMotion:
    """The velocity of a camera within a frame, and when the frame's rows were read."""

    times: RowTimes
    velocity: Array  # (6,) shift [m/s] and turn [rad/s] along world axes

    def depth_at_stamp(self, points: Tensor, rows: Tensor) -> Tensor:
        """Points (N, 3) that depth's rows (N,) have read, as the camera sees them at the time stamp; from its centre, along world axes."""
        return carried(points, self.times.depth_delay + self.times.depth_readout * rows, self.velocity)

    def depth_at_rows(self, points: Tensor, rows: Tensor) -> Tensor:
        """The inverse of `depth_at_stamp`: points (N, 3) at the time stamp, as depth's rows (N,) see them."""
        return carried(points, -(self.times.depth_delay + self.times.depth_readout * rows), self.velocity)

    def colour_at_rows(self, points: Tensor, rows: Tensor) -> Tensor:
        """The same for colour's rows (N,)."""
        return carried(points, -self.times.readout * rows, self.velocity)


def numbers_of(motion: FrameMotion | None) -> tuple[Array, Array]:
    """The times (3,) [s] and the velocity (6,) of a motion for compiled loops; zero for none."""
    return (np.zeros(3), np.zeros(6)) if motion is None else (motion.times.array, motion.velocity)


def carried(points: Tensor, seconds: Tensor, velocity: Array) -> Tensor:
    """Points (N, 3), as a camera sees them `seconds` (N,) before, from its centre along world axes: exp(seconds velocity) p."""
    return pick(points, compiled=compiled_carried, plain=plain_carried)(points, seconds, velocity)


def plain_carried(points: Tensor, seconds: Tensor, velocity: Array) -> Tensor:
    """`carried` in torch, on any device."""
    v, w = (torch.from_numpy(part).to(points).expand_as(points) for part in (velocity[:3], velocity[3:]))
    rate = torch.linalg.cross(w, points) + v
    s = seconds[:, None]
    return points + s * rate + s * s / 2 * torch.linalg.cross(w, rate)


def compiled_carried(points: Tensor, seconds: Tensor, velocity: Array) -> Tensor:
    """`carried` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_depth

    out = torch.empty_like(points)
    numba_depth.carry_points(points.numpy(), seconds.numpy(), velocity, out.numpy())  # type: ignore[call-arg]
    return out
