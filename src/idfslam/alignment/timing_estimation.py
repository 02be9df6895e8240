"""The read-out times of rolling shutters and the delay of depth, estimated from the distortions of moving frames.

A row f of an image (-0.5 at its top, 0.5 at its bottom), exposed s seconds after the frame's time stamp, sees the camera displaced by s
times its velocity. So the residuals of a frame that is aligned with a wrong readout grow with f, in proportion to the velocity. References
are distorted by their own velocity, so the difference of the two velocities counts. Each frame gives normal equations for the three times,
from which its pose and its velocity are eliminated; they are summed over the frames.
"""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.alignment.continuous_motion import MotionPrior, distorted, joint_system
from idfslam.alignment.row_moments import RowMoments
from idfslam.geometry.sensor_timing import SensorTiming
from idfslam.sensing.rectification import RowTimes
from idfslam.storage.state import State, Stateful

Array = NDArray[np.float64]

# [s] Standard deviation of a time that nobody states: half of a slow sensor's read-out. More: times are estimated from less motion.
_PRIOR = 0.015
# [1] Standard deviations by which a time must differ from zero to be used. More: slow recordings stay as they are, and true times are used
# later.
SIGNIFICANT = 4.0
# [1] Share of the sums that is kept from frame to frame. More: the estimate is steadier, and early frames, tracked without times, count for
# longer.
_KEPT = 0.99
_LONGEST = 0.04  # [s] largest read-out time and delay that is believed. More: wrong estimates of odd recordings are used


class TimingEstimator(Stateful):
    """Estimates those times of a sensor that are unknown."""

    def __init__(self) -> None:
        self._information, self._vector = np.zeros((3, 3)), np.zeros(3)

    def state(self) -> State:
        """The sums."""
        return {"information": torch.from_numpy(self._information.copy()), "vector": torch.from_numpy(self._vector.copy())}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._information, self._vector = state["information"].numpy().copy(), state["vector"].numpy().copy()

    @property
    def has_seen_motion(self) -> bool:
        """Whether a frame has told of the times."""
        return bool(self._information.any())

    def of(self, stated: SensorTiming, lag: float) -> RowTimes:
        """The times of a frame: those that are stated, and the estimates of the others. lag [s]: depth's time stamp minus colour's."""
        readout, depth_readout, depth_delay = self.timing(stated)
        return RowTimes(readout, depth_readout, lag + depth_delay)

    def timing(self, stated: SensorTiming) -> tuple[float, float, float]:
        """Readout, depth readout and depth delay [s]: as stated, or as estimated where that is significant, or zero."""
        values = [stated.readout, stated.depth_readout, stated.depth_delay]
        unknown = [k for k in range(3) if values[k] is None]
        for k, value, sigma in zip(unknown, *self._estimate(values)):
            least = 0.0 if k < 2 else -_LONGEST
            values[k] = float(np.clip(value, least, _LONGEST)) if abs(value) > SIGNIFICANT * sigma else 0.0
        return values[0] or 0.0, values[1] or 0.0, values[2] or 0.0

    def estimates(self, stated: SensorTiming) -> dict[str, tuple[float, float]]:
        """Value and standard deviation [s] of each time that is not stated, by name, significant or not."""
        values = vars(stated)
        unknown = [name for name, value in values.items() if value is None]
        found = zip(*self._estimate(list(values.values())))
        return {name: (float(value), float(sigma)) for name, (value, sigma) in zip(unknown, found)}

    def _estimate(self, values: Sequence[float | None]) -> tuple[Array, Array]:
        """The unknown times [s] and their standard deviations, given the others."""
        known = np.array([value is not None for value in values])
        given = np.array([value or 0.0 for value in values])
        information = self._information[~known][:, ~known] + np.eye(int((~known).sum())) / _PRIOR**2
        vector = self._vector[~known] - self._information[~known][:, known] @ given[known]
        covariance = np.linalg.inv(information)
        return covariance @ vector, np.sqrt(np.diag(covariance))

    def add(self, depth: RowMoments, images: RowMoments, times: RowTimes, lag: float, since_references: Array, prior: MotionPrior) -> None:
        """Adds a frame.

        depth, images: the sums at its pose, in units of information. times: those that it was aligned with. lag [s]: depth's stamp minus
        colour's. since_references (6,): the frame's velocity minus that of its references, along world axes.
        """
        H, b = distorted(*joint_system(depth, images, times))
        D, C = depth.H, images.H
        u = since_references
        by_pose = np.stack([C[1] @ u, D[1] @ u, D[0] @ u], 1)
        delay, r, c = times.depth_delay, times.depth_readout, times.readout
        by_velocity = np.stack([c * C[2] @ u, (delay * D[1] + r * D[2]) @ u, (delay * D[0] + r * D[1]) @ u], 1)
        cross = np.concatenate([by_pose, by_velocity, by_velocity])
        square = np.array([[u @ C[2] @ u, 0, 0], [0, u @ D[2] @ u, u @ D[1] @ u], [0, u @ D[1] @ u, u @ D[0] @ u]])
        gradient = np.array([u @ images.b[1], u @ depth.b[1], u @ depth.b[0]])
        gain = np.linalg.solve(H + prior.with_reference_error, cross)
        information = square - cross.T @ gain
        at = np.array([times.readout, times.depth_readout, times.depth_delay - lag])
        self._information = _KEPT * self._information + information
        self._vector = _KEPT * self._vector + gradient - gain.T @ b + information @ at
