"""Temporal calibration while a run goes on: the read-out times of the images and the delay of depth, learnt from frames that move.

A frame tells of them once the frame after it is known: its velocity is exacter then (`alignment/timing_estimation.py` has the estimator).
The name is that of Furgale, Rehder and Siegwart, "Unified temporal and spatial calibration for multi-sensor systems" (IROS 2013).
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from idfslam.alignment.aligner import MapAligner
from idfslam.alignment.continuous_motion import Smoothed
from idfslam.alignment.frame_motion import FrameMotion
from idfslam.alignment.timing_estimation import MovingFrame, TimingEstimator
from idfslam.frame import Frame
from idfslam.geometry.sensor_timing import SYNCHRONISED, SensorTiming
from idfslam.graph.keyframe import Keyframe
from idfslam.sensing.rectification import RowTimes, displacement
from idfslam.slam.front_end.keyframe_velocity import mean_velocity
from idfslam.storage.state import State, Stateful

Array = NDArray[np.float64]

# [px] Least displacement in `_TYPICAL` of the difference of a frame's velocity to its references', for the frame to tell about the times.
# More: fewer frames are used, and slow recordings take less time. Chosen by hand.
_TELLING = 1.0
_TYPICAL = 0.01  # [s] half of a usual read-out time. More: slower motion tells about the times. Chosen by hand
_NAMES = "readout", "depth_readout", "depth_delay"


class TemporalCalibration(Stateful):
    """Knows the times of the rows of a sensor's images: as frames state them, and as moving frames tell those that are not stated."""

    def __init__(self, aligner: MapAligner) -> None:
        self.aligner, self.estimator = aligner, TimingEstimator()
        self.stated = SYNCHRONISED  # the times that the frames state
        self._told: MovingFrame | None = None  # what the frame before tells
        self._running: Future[MovingFrame] | None = None  # the same, while it is worked out beside what follows
        self._pool = ThreadPoolExecutor(1, "times")

    def state(self) -> State:
        """The times that the last frame stated, and what it tells of those that it does not."""
        self._settle()
        return {"stated": list(vars(self.stated).values()), "told": None if self._told is None else self._told.state()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.stated = SensorTiming(*state["stated"])
        self._told = None if state["told"] is None else MovingFrame.of(state["told"])

    def times(self, keyframe: Keyframe) -> RowTimes:
        """The times of the rows of a keyframe's images, as they were taken: stated, estimated, or zero."""
        return self.estimator.of(keyframe.timing, keyframe.depth_lag)

    def likeliest_times(self, keyframe: Keyframe) -> tuple[RowTimes, Array]:
        """The same with estimates that are not significant, and standard deviations (3,) [s]: zero until the motion tells of them."""
        found = self.estimates() or {}
        sigmas = np.array([found[name][1] if name in found else 0.0 for name in _NAMES])
        return (self.estimator.likeliest(keyframe.timing, keyframe.depth_lag) if found else self.times(keyframe)), sigmas

    def used(self) -> dict[str, float] | None:
        """The estimates of the unknown times [s] by name, to a tenth of a millisecond, 0 where not significant; None if none is."""
        found = dict(zip(_NAMES, self.estimator.timing(self.stated)))
        unknown = {name: round(found[name], 4) for name, stated in vars(self.stated).items() if stated is None}
        return unknown if any(unknown.values()) else None

    def estimates(self) -> dict[str, tuple[float, float]] | None:
        """Value and standard deviation [s] of the unknown times by name, significant or not; None without any, or before they are told."""
        return self.estimator.estimates(self.stated) or None if self.estimator.has_seen_motion else None

    def timing_error_as_velocity(self, velocity: Array, times: RowTimes, references: Sequence[Keyframe]) -> Array:
        """(6, 6) second moments, along world axes, of the error of velocity that would distort a frame as the error of its times does.

        A frame is distorted by its times times its velocity (6,) against the references: a share of the times is a share of that velocity.
        """
        share, of_references = self.estimator.relative_error(self.stated, times), mean_velocity(references)
        if not share or of_references is None:
            return np.zeros((6, 6))
        since_references = velocity - of_references
        return share**2 * np.outer(since_references, since_references)

    def observe(
        self, frame: Frame, view: Keyframe, T_wc: Tensor, velocity: Array, references: Sequence[Keyframe], reference_covariance: Array
    ) -> None:
        """Begins to work out what a frame tells, unless it hardly moves against its references.

        frame: as it was taken; view: the same, rectified, at a pose (4, 4) and a velocity (6,). reference_covariance (6, 6): of the
        velocities that the references were rectified with.
        """
        if None in vars(frame.timing).values() and (told := self._told_by(frame, view, T_wc, velocity, references, reference_covariance)):
            self._running = self._pool.submit(told)

    def learn(self, smoothed: Smoothed | None) -> None:
        """Takes over what the frame before tells, by its velocity as the present frame has improved it. None: it is not known."""
        self._settle()
        told, self._told = self._told, None
        if told is not None and smoothed is not None:
            self.estimator.add(told, *smoothed, self.stated)

    def forget_last(self) -> None:
        """The velocity of the last frame will not be known better."""
        self._told, self._running = None, None

    def _settle(self) -> None:
        """Waits for what the frame before tells."""
        if self._running is not None:
            self._told, self._running = self._running.result(), None

    def _told_by(
        self, frame: Frame, view: Keyframe, T_wc: Tensor, velocity: Array, references: Sequence[Keyframe], reference_covariance: Array
    ) -> Callable[[], MovingFrame] | None:
        """What `observe` begins: it is worked out when it is called, in this thread or another."""
        of_references = mean_velocity(references)
        if of_references is None or displacement(frame, velocity - of_references, _TYPICAL) < _TELLING:
            return None
        times = RowTimes() if view.rectification is None else view.rectification.times
        lag = 0.0 if view.rectification is None else frame.depth_lag
        depth, images = self.aligner.row_moments(view, T_wc, references, FrameMotion(times, velocity))
        with_velocities = times, lag, velocity, of_references, reference_covariance
        return lambda: MovingFrame(depth, images(), *with_velocities)
