"""The read-out times of rolling shutters and the delay of depth, estimated from the distortions of moving frames.

A row f of an image (-0.5 at its top, 0.5 at its bottom), exposed s seconds after the frame's time stamp, sees the camera displaced by s
times its velocity. So the residuals of a frame that is aligned with a wrong readout grow with f, in proportion to the velocity. References
are distorted by their own velocity, so the difference of the two velocities counts. Each frame gives normal equations for the three times,
from which its pose and its velocity are eliminated; they are summed over the frames. A frame counts one frame later: its velocity is four
times as exact then, and an inexact velocity draws the times towards those that were used.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.alignment.joint_equations import joint_system, with_reference_error
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
# longer. With 0.99, generated recordings are the same, and the times of fr1/rpy come half as far in its 340 frames.
_KEPT = 0.98
# [1] Correlation that is expected of what neighbouring frames tell beyond the estimate: they share keyframes, map and errors of velocity
# for about ten frames. More: larger deviations. Chosen by hand: with 0.7 and 0.9 fr1/rpy is the same.
_CORRELATED = 0.9
_SHORTEST = 1e-3  # [s] distortion, as a root mean square, below which errors count as those of this one. More: less weight for short times
# [1/m^2], [1/rad^2] Information on the pose beside the frame's own, for directions that it leaves open: more than the motion before tells
# makes the times seem surer than they are. More: those directions count as known.
_LEAST_INFORMATION = 10.0
_LONGEST = 0.04  # [s] largest read-out time and delay that is believed. More: wrong estimates of odd recordings are used


@dataclass(frozen=True)
class MovingFrame:
    """What a frame tells of the times, with the velocity that it was aligned with."""

    depth: RowMoments  # the sums at its pose, in units of information
    images: RowMoments
    times: RowTimes  # that it was aligned with
    lag: float  # [s] depth's time stamp minus colour's, as far as `times` has it
    velocity: Array  # (6,) that the sums were taken at, along world axes
    of_references: Array  # (6,) the mean velocity of its references
    reference_covariance: Array  # (6, 6) of the velocities that the references were rectified with

    def state(self) -> State:
        """All of it."""
        sums = {"depth_H": self.depth.H, "depth_b": self.depth.b, "images_H": self.images.H, "images_b": self.images.b}
        arrays = {name: getattr(self, name) for name in ("velocity", "of_references", "reference_covariance")}
        values = {name: torch.from_numpy(value.copy()) for name, value in (sums | arrays | {"times": self.times.array}).items()}
        return {**values, "lag": self.lag}

    @staticmethod
    def of(state: State) -> "MovingFrame":
        """The frame of a `state`."""
        arrays = {name: value.numpy().copy() for name, value in state.items() if name != "lag"}
        depth, images = (RowMoments(arrays[f"{of}_H"], arrays[f"{of}_b"]) for of in ("depth", "images"))
        velocities = arrays["velocity"], arrays["of_references"], arrays["reference_covariance"]
        return MovingFrame(depth, images, RowTimes(*map(float, arrays["times"])), state["lag"], *velocities)


def _mean_square(readout: float, depth_readout: float, depth_delay: float) -> float:
    """[s^2] of the times of all rows of both images; rows are spread evenly over a read-out."""
    return depth_delay**2 + (readout**2 + depth_readout**2) / 12


class TimingEstimator(Stateful):
    """Estimates those times of a sensor that are unknown."""

    def __init__(self) -> None:
        self._information, self._vector = np.zeros((3, 3)), np.zeros(3)
        self._scatter, self._before = np.zeros((3, 3)), np.zeros(3)  # of what frames told beyond the estimate, and what those before told
        self._solved: dict[tuple[float | None, ...], tuple[Array, Array, Array]] = {}  # of the present sums, by the times that are stated

    def state(self) -> State:
        """The sums."""
        sums = {"information": self._information, "vector": self._vector, "scatter": self._scatter, "before": self._before}
        return {name: torch.from_numpy(value.copy()) for name, value in sums.items()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._information, self._vector = state["information"].numpy().copy(), state["vector"].numpy().copy()
        self._scatter, self._before = state["scatter"].numpy().copy(), state["before"].numpy().copy()
        self._solved.clear()

    @property
    def has_seen_motion(self) -> bool:
        """Whether a frame has told of the times."""
        return bool(self._information.any())

    def of(self, stated: SensorTiming, lag: float) -> RowTimes:
        """The times of a frame: those that are stated, and the estimates of the others. lag [s]: depth's time stamp minus colour's."""
        readout, depth_readout, depth_delay = self.timing(stated)
        return RowTimes(readout, depth_readout, lag + depth_delay)

    def likeliest(self, stated: SensorTiming, lag: float) -> RowTimes:
        """The same with all estimates, significant or not."""
        found = {name: value for name, (value, _) in self.estimates(stated).items()}
        known = {name: found.get(name, value or 0.0) for name, value in vars(stated).items()}
        return RowTimes(known["readout"], known["depth_readout"], lag + known["depth_delay"])

    def timing(self, stated: SensorTiming) -> tuple[float, float, float]:
        """Readout, depth readout and depth delay [s]: as stated, or as estimated where that is significant, or zero."""
        values = [stated.readout, stated.depth_readout, stated.depth_delay]
        unknown = [k for k in range(3) if values[k] is None]
        for k, value, sigma, _ in zip(unknown, *self._estimate(values)):
            least = 0.0 if k < 2 else -_LONGEST
            values[k] = float(np.clip(value, least, _LONGEST)) if abs(value) > SIGNIFICANT * sigma else 0.0
        return values[0] or 0.0, values[1] or 0.0, values[2] or 0.0

    def estimates(self, stated: SensorTiming) -> dict[str, tuple[float, float]]:
        """Value and standard deviation [s] of each time that is not stated, by name, significant or not.

        The deviation is that of correlated frames (the sandwich of Newey and West, Econometrica 1987), and no less than the formal one.
        """
        values = vars(stated)
        unknown = [name for name, value in values.items() if value is None]
        found = zip(*self._estimate(list(values.values())))
        return {name: (float(value), max(float(formal), float(sigma))) for name, (value, formal, sigma) in zip(unknown, found)}

    def relative_error(self, stated: SensorTiming, times: RowTimes) -> float:
        """The error that is expected of the distortions of a frame with these times, over the distortions [1]; 0 if all times are stated.

        Both are root mean squares over the rows of both images, for a velocity of 1.
        """
        values = vars(stated)
        sigmas = dict(zip((name for name, value in values.items() if value is None), self._estimate(list(values.values()))[1]))
        error = _mean_square(*(sigmas.get(name, 0.0) for name in ("readout", "depth_readout", "depth_delay")))
        return math.sqrt(error / max(_mean_square(times.readout, times.depth_readout, times.depth_delay), _SHORTEST**2)) if error else 0.0

    def _estimate(self, values: Sequence[float | None]) -> tuple[Array, Array, Array]:
        """The unknown times [s], given the others, and their standard deviations, if frames are independent, and if they are correlated.

        Each frame asks for them several times.
        """
        stated = tuple(values)
        if stated not in self._solved:
            self._solved[stated] = self._solution(stated)
        return self._solved[stated]

    def _solution(self, values: Sequence[float | None]) -> tuple[Array, Array, Array]:
        """`_estimate` from the sums."""
        known = np.array([value is not None for value in values])
        given = np.array([value or 0.0 for value in values])
        prior = np.eye(int((~known).sum())) / _PRIOR**2
        information = self._information[~known][:, ~known] + prior
        vector = self._vector[~known] - self._information[~known][:, known] @ given[known]
        covariance = np.linalg.inv(information)
        of_correlated = covariance @ (self._scatter[~known][:, ~known] + prior) @ covariance
        return covariance @ vector, np.sqrt(np.diag(covariance)), np.sqrt(np.maximum(np.diag(of_correlated), 0.0))

    def add(self, frame: "MovingFrame", velocity: Array, velocity_covariance: Array, stated: SensorTiming) -> None:
        """Adds a frame whose velocity (6,) along world axes is known by now, with this covariance (6, 6). stated: its times."""
        H, b = with_reference_error(*joint_system(frame.depth, frame.images, frame.times))
        D, C, times = frame.depth.H, frame.images.H, frame.times
        u, corrected = velocity - frame.of_references, velocity - frame.velocity
        by_pose = np.stack([C[1] @ u, D[1] @ u, D[0] @ u], 1)
        delay, r, c = times.depth_delay, times.depth_readout, times.readout
        by_velocity = np.stack([c * C[2] @ u, (delay * D[1] + r * D[2]) @ u, (delay * D[0] + r * D[1]) @ u], 1)
        cross = np.concatenate([by_pose, by_velocity, by_velocity])
        square = np.array([[u @ C[2] @ u, 0, 0], [0, u @ D[2] @ u, u @ D[1] @ u], [0, u @ D[1] @ u, u @ D[0] @ u]])
        b = b - H[:, 6:12] @ corrected
        gradient = np.array([u @ frame.images.b[1], u @ frame.depth.b[1], u @ frame.depth.b[0]]) - by_velocity.T @ corrected
        prior = np.diag(np.repeat([_LEAST_INFORMATION, 0.0, 0.0], 6))
        prior[6:12, 6:12], prior[12:, 12:] = np.linalg.inv(velocity_covariance), np.linalg.inv(frame.reference_covariance)
        gain = np.linalg.solve(H + prior, cross)
        information = square - cross.T @ gain
        at = np.array([times.readout, times.depth_readout, times.depth_delay - frame.lag])
        vector = gradient - gain.T @ b + information @ at
        self._scatter = _KEPT**2 * self._scatter + self._scattered(vector - information @ self._all(stated))
        self._information = _KEPT * self._information + information
        self._vector = _KEPT * self._vector + vector
        self._solved.clear()

    def _all(self, stated: SensorTiming) -> Array:
        """(3,) [s] the times: those that are stated, and the estimates of the others, significant or not."""
        values = list(vars(stated).values())
        times = np.array([value or 0.0 for value in values])
        times[[value is None for value in values]] = self._estimate(values)[0]
        return times

    def _scattered(self, left: Array) -> Array:
        """(3, 3) what a frame adds to the scatter, by what it told beyond the estimate (3,), and what frames before it told so."""
        self._before = _CORRELATED * self._before
        cross = np.outer(left, self._before)
        self._before = self._before + left
        return np.outer(left, left) + cross + cross.T
