"""Continuous-time motion: a frame has a pose and a velocity, which are estimated together.

The velocity changes from frame to frame as a random walk (`acceleration_noise.py`). Within a frame it is constant. Rows of a rolling
shutter and depth of another moment measure the pose at their own times, and so also the velocity. A Kalman filter carries both from frame
to frame: it predicts the prior of the next frame's alignment, and takes over its result.

A velocity is a 6-vector of shift [m/s] and turn [rad/s], both along world axes, so that a pose s seconds later is `moved(T, s velocity)`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.alignment.acceleration_noise import Passage
from idfslam.alignment.frame_interval import FrameInterval
from idfslam.alignment.motion import change_between, moved
from idfslam.storage.state import State, Stateful

Array = NDArray[np.float64]
Smoothed = tuple[Array, Array]  # a velocity (6,), and its covariance (6, 6)

# [m], [rad] Least deviation from constant velocity in a frame that is expected. More: velocities of a slow camera are noisier.
_LEAST_DEVIATION = 5e-4, 5e-4
# [m], [rad] Deviation that is expected at first, and after frames without a pose: a hand that begins to shake. More: the first velocities
# are noisier.
_FIRST_DEVIATION = 1e-2, 2e-2
# [1] Decay a frame of the largest recent deviation. More: a shaking hand is expected to shake for longer.
_DECAY = 0.9
# [1] Least correlation of the motion to a frame with that to the frame before: half of what steady motion has. Photographs round a chair
# have 0.2, freiburg1_rpy 0.9, a generated shaking hand 0.8 at 30 frames a second and 0.5 at 15. More: a shaking hand tells less of the
# sensor's times.
_CORRELATED = 0.5
# [1] Share of its sums that is kept from frame to frame: about 20 frames. More: it takes longer to tell that frames are far apart.
_REMEMBERED = 0.95
# [m], [rad] Standard deviation of a pose in the map around it. More: velocities are smoother and lag behind.
_POSE_ERROR = 2e-3, 2e-3
# [m/s], [rad/s] Standard deviation of a hand's velocity, of which nothing else is known. More: wrong velocities of blurred frames last
# longer, and the first keyframes of a run move more freely in adjustments.
HAND_SPEED = 0.5, 1.5
# [standard deviations] Largest speed that is a hand's: 6 rad/s, where a hand was seen to turn by 3.7. Photographs stamped as a video's have
# 9. More: photographs pass for a video. Chosen by hand.
_FASTEST = 4.0
# [m/s], [rad/s] Least standard deviation of the velocities with which the references were rectified. It stands for what no constant
# velocity describes. A frame's distortion is measured against theirs. More: the velocity follows the change of the pose more, and the
# distortion less. At ten times as much, velocities in shaken passages were three times less exact (docs/findings.md).
REFERENCE_ERROR = 0.05, 0.1


@dataclass(frozen=True)
class MotionPrior:
    """A Gaussian prior of a frame's pose and velocity, from the frames before it."""

    T_wc: Tensor  # (4, 4) float64
    velocity: Array  # (6,)
    information: Array  # (12, 12) of the change of the pose and of the velocity
    reference_covariance: Array = field(default_factory=lambda: np.diag(np.repeat(np.array(REFERENCE_ERROR) ** 2, 3)))
    # (6, 6) of the references' error of velocity

    @property
    def with_reference_error(self) -> Array:
        """(18, 18) the information, and that of the references' error of velocity."""
        out = np.zeros((18, 18))
        out[:12, :12] = self.information
        out[12:, 12:] = np.linalg.inv(self.reference_covariance)
        return out

    def against(self, errors: Sequence[Array]) -> "MotionPrior":
        """The same for a frame that is aligned to references whose velocities have these covariances (6, 6), along world axes."""
        least = np.diag(np.repeat(np.array(REFERENCE_ERROR) ** 2, 3))
        return replace(self, reference_covariance=least + np.mean(errors, 0)) if len(errors) else self


@dataclass(frozen=True)
class JointEstimate:
    """A velocity estimated with a pose, and the covariance of both."""

    velocity: Array  # (6,)
    covariance: Array  # (12, 12) of pose and velocity


@dataclass(frozen=True)
class Filtered:
    """What a frame and those before it tell of its motion."""

    R_wc: Array  # (3, 3) of its pose, to whose world velocity and covariance belong
    velocity: Array  # (6,) along world axes
    covariance: Array  # (12, 12) of pose and velocity
    passage: Passage | None  # from the frame before; None: that frame is not known


def is_of_a_hand(velocity: Array) -> bool:
    """Whether a velocity (6,) [m/s], [rad/s] is no faster than a hand's."""
    return bool((np.linalg.norm(velocity.reshape(2, 3), axis=1) <= _FASTEST * np.array(HAND_SPEED)).all())


class ContinuousMotion(Stateful):
    """Predicts pose and velocity of each frame, and learns from the estimates how much the velocity changes."""

    def __init__(self) -> None:
        self.velocity: Array = np.zeros(6)
        self._last: tuple[float, Tensor] | None = None  # stamp and pose of the last frame; None: they are not known
        self._covariance: Array = np.zeros((12, 12))  # of its pose and velocity
        self._deviation: Array = np.array(_FIRST_DEVIATION)
        self.interval = FrameInterval()
        self._motion: Array = np.zeros(6)  # from the frame before the last to the last, a second [m/s], [rad/s]
        self._sums: Array = np.zeros(2)  # over recent frames: of products with the motion before, and of squares
        self.stop()

    def state(self) -> State:
        """Velocity, last pose, their covariance, the expected deviation, the intervals, and the correlation of motion."""
        last = None if self._last is None else {"timestamp": self._last[0], "T_wc": self._last[1]}
        arrays = {"velocity": self.velocity, "covariance": self._covariance, "deviation": self._deviation}
        arrays |= {"motion": self._motion, "sums": self._sums}
        return {**{k: torch.from_numpy(v.copy()) for k, v in arrays.items()}, "last": last, "intervals": self.interval.recent()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        arrays = (state[k].numpy().copy() for k in ("velocity", "covariance", "deviation", "motion", "sums"))
        self.velocity, self._covariance, self._deviation, self._motion, self._sums = arrays
        self._last = None if state["last"] is None else (state["last"]["timestamp"], state["last"]["T_wc"])
        self.interval = FrameInterval(state["intervals"])

    def follow(self, T_last: Tensor) -> None:
        """Moves the last pose to where the graph has it by now, (4, 4): loops and refined keyframes move it. The velocity turns with it."""
        if self._last is None:
            return
        R = (T_last[:3, :3] @ self._last[1][:3, :3].T).numpy()
        self.velocity = np.concatenate([R @ self.velocity[:3], R @ self.velocity[3:]])
        self._last = (self._last[0], T_last.clone())

    def predict(self, timestamp: float, T_predicted: Tensor) -> MotionPrior:
        """The prior of the frame at `timestamp` [s]. T_predicted (4, 4): its pose if no frame before it has one."""
        if self._last is None:
            return MotionPrior(T_predicted, self.velocity, _inverse(self._covariance))
        dt = self._elapsed(timestamp)
        information = _inverse(Passage(dt, self._deviation).predicted(self._covariance))
        mean = np.concatenate([dt * self.velocity, self.velocity])  # change since the last pose, and velocity
        bounded = information.copy()
        bounded[6:, 6:] += np.diag(np.repeat(np.array(HAND_SPEED) ** -2.0, 3))  # a hand is seldom faster
        mean = np.linalg.solve(bounded, information @ mean)
        return MotionPrior(moved(self._last[1], torch.from_numpy(mean[:6])), mean[6:], bounded)

    def start(self, T_first: Tensor, T_wc: Tensor, elapsed: float) -> None:
        """Takes the velocity from the motion between the poses (4, 4) of the first two frames, `elapsed` [s] apart."""
        self.velocity = change_between(T_first, T_wc).numpy() / elapsed
        self._covariance[6:, 6:] = np.diag(np.repeat(2 * (np.array(_POSE_ERROR) / elapsed) ** 2, 3))

    def accept_pose(self, timestamp: float, T_wc: Tensor, prior: MotionPrior) -> Smoothed | None:
        """Takes over a pose (4, 4) that was estimated without a velocity, of the frame at `timestamp` [s]. Returns what `accept` does."""
        measured = prior.information.copy()
        measured[:6, :6] += np.diag(np.repeat(np.array(_POSE_ERROR) ** -2.0, 3))
        covariance = _inverse(measured)
        change = change_between(prior.T_wc, T_wc).numpy()
        velocity = prior.velocity + (covariance @ np.concatenate([np.repeat(np.array(_POSE_ERROR) ** -2.0, 3) * change, np.zeros(6)]))[6:]
        return self.accept(timestamp, T_wc, velocity, covariance, prior)

    def accept(self, timestamp: float, T_wc: Tensor, velocity: Array, covariance: Array, prior: MotionPrior) -> Smoothed | None:
        """Takes over the pose (4, 4) and the velocity (6,) of the frame at `timestamp` [s], with their covariance (12, 12).

        Returns the velocity of the frame before, which they improve; None if that frame is not known.
        """
        smoothed = self._smoothed(timestamp, T_wc, velocity, covariance)
        if self._last is not None:
            change = change_between(prior.T_wc, T_wc).numpy()
            deviation = np.array([np.sqrt((change[:3] ** 2).mean()), np.sqrt((change[3:] ** 2).mean())])
            self._deviation = np.maximum(np.maximum(deviation, _DECAY * self._deviation), _LEAST_DEVIATION)
            motion = change_between(self._last[1], T_wc).numpy() / self._elapsed(timestamp)
            self._sums = _REMEMBERED * self._sums + [motion @ self._motion, motion @ motion]
            self._motion = motion
            self.interval.add(timestamp - self._last[0])
        self.velocity, self._covariance = velocity, covariance
        self._last = (timestamp, T_wc.clone())
        return smoothed

    def _smoothed(self, timestamp: float, T_wc: Tensor, velocity: Array, covariance: Array) -> Smoothed | None:
        """The last frame's velocity (6,), which that of the next frame and the way to it improve, and its covariance (6, 6).

        One step of the smoother of Rauch, Tung and Striebel (1965). None: the last frame is not known.
        """
        if self._last is None:
            return None
        dt = self._elapsed(timestamp)
        passage = Passage(dt, self._deviation)
        predicted = passage.predicted(self._covariance)
        gain = self._covariance @ passage.transition.T @ _inverse(predicted)
        change = np.concatenate([change_between(self._last[1], T_wc).numpy() - dt * self.velocity, velocity - self.velocity])
        smoothed = self._covariance + gain @ (covariance - predicted) @ gain.T
        return self.velocity + (gain @ change)[6:], smoothed[6:, 6:]

    def filtered(self, T_wc: Tensor, passage: Passage | None) -> Filtered:
        """What is known of the last frame, at `T_wc` (4, 4), to which this passage led."""
        return Filtered(T_wc[:3, :3].numpy().copy(), self.velocity.copy(), self._covariance.copy(), passage)

    def passage(self, timestamp: float) -> Passage | None:
        """From the last frame to the one at `timestamp` [s]; None: the last frame is not known."""
        return None if self._last is None else Passage(self._elapsed(timestamp), self._deviation.copy())

    @property
    def is_continuous(self) -> bool:
        """Whether the motion goes on from frame to frame. Otherwise, as in photographs, frames have no velocity that poses could tell."""
        product, square = self._sums
        return bool(product > _CORRELATED * square)

    @property
    def is_of_a_hand(self) -> bool:
        """Whether the motion to the last frame was no faster than a hand's, as that between photographs is."""
        return is_of_a_hand(self._motion)

    @property
    def velocity_covariance(self) -> Array:
        """(6, 6) of the velocity."""
        return self._covariance[6:, 6:]

    def stop(self) -> None:
        """Forgets the motion, after a frame that is lost or whose pose is no continuation of the one before."""
        self._last, self.velocity = None, np.zeros(6)
        self._deviation = np.array(_FIRST_DEVIATION)
        self._covariance = np.diag(np.repeat(np.array([*_FIRST_DEVIATION, *HAND_SPEED]) ** 2, 3))

    def _elapsed(self, timestamp: float) -> float:
        """[s] since the last frame, in whole frames."""
        assert self._last is not None
        return self.interval.in_whole_frames(timestamp - self._last[0])


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), np.float64)
