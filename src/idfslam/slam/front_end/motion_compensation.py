"""Motion compensation: a frame of a moving camera has a velocity, which is estimated with its pose and rectifies its images.

A rolling shutter and depth of another moment distort a frame by its velocity. Kerl, Stückler and Cremers, "Dense continuous-time tracking
and mapping with rolling shutter RGB-D cameras" (ICCV 2015) model the same by splines.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from idfslam.alignment.aligner import MapAligner
from idfslam.alignment.alignment import Alignment
from idfslam.alignment.continuous_motion import ContinuousMotion, MotionPrior, Smoothed
from idfslam.alignment.motion_smoother import MotionSmoother
from idfslam.frame import Frame, Status
from idfslam.graph.keyframe import Keyframe
from idfslam.sensing.rectification import Rectification, RowTimes, along_camera
from idfslam.slam.front_end.keyframe_rectification import KeyframeRectification
from idfslam.slam.front_end.keyframe_velocity import give_velocity, mean_velocity, unrectified_velocity_moments
from idfslam.slam.front_end.temporal_calibration import TemporalCalibration
from idfslam.slam.tracked import Source, Tracked
from idfslam.storage.state import State, Stateful

Array = NDArray[np.float64]


class MotionCompensation(Stateful):
    """Gives the frames of a front end their velocities, and rectifies them by these and the sensor's times.

    A frame of a synchronised global shutter passes unchanged.
    """

    def __init__(self, aligner: MapAligner) -> None:
        self.motion, self.smoother = ContinuousMotion(), MotionSmoother()
        self.calibration = TemporalCalibration(aligner)
        self.keyframes = KeyframeRectification(self.calibration, aligner.appearances)
        self._raw: Frame | None = None  # the present frame as it was taken; None: its sensor is stated to be synchronised
        self._prior: MotionPrior | None = None  # of the present frame's motion
        self._reference_covariance: Array | None = None  # (6, 6) of the velocities that the present references were rectified with
        self._before: int | None = None  # index of the frame before, if it has a velocity

    def state(self) -> State:
        """The frame before."""
        return {"before": self._before}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._before = state["before"]

    def begin(self, view: Keyframe, T_last: Tensor, references: Sequence[Keyframe]) -> MotionPrior | None:
        """Gives a view its predicted velocity and pose. T_last (4, 4): of the frame before, as the graph has it.

        references: the keyframes that it is aligned to.
        Returns the prior of its motion. None: all its rows have one time, as far as is known, and the view is unchanged.
        """
        self._raw, self._prior = None, None
        if view.taken.frame.synchronised:
            return None
        self._raw, self.calibration.stated = view.taken.frame, view.taken.frame.timing
        self.motion.follow(T_last)
        return self.begin_again(view, references)

    def begin_again(self, view: Keyframe, references: Sequence[Keyframe]) -> MotionPrior | None:
        """The same with the present view, after the motion has become known."""
        assert self._raw is not None
        prior, times = self.motion.predict(view.timestamp, view.T_wk), self.calibration.times(view)
        by_times = self.calibration.timing_error_as_velocity(prior.velocity, times, references)
        errors = [unrectified_velocity_moments(k) for k in references if k.velocity is not None]
        self._reference_covariance = prior.against(errors).reference_covariance
        self._prior = prior.against([error + by_times for error in errors])
        if times.synchronised:
            return None
        view.T_wk = self._prior.T_wc
        self._rectify(view, times, self._prior.velocity, view.T_wk)
        return self._prior

    def depth_displacement(self, view: Keyframe, references: Sequence[Keyframe]) -> Array | None:
        """(6, 6) second moments, along world axes, of the camera's displacement when it took a view's depth, by a delay that is not known.

        None: the delay is stated, or one of the times is in use, or frames are as far apart as photographs.
        """
        known = view.timing.depth_delay is not None or not self.calibration.times(view).synchronised
        if self._prior is None or known or not self.motion.is_of_a_hand:
            return None
        of_references, covariance = mean_velocity(references), np.linalg.inv(self._prior.information)[6:, 6:]
        velocity = self._prior.velocity - (0.0 if of_references is None else of_references)
        mean, sigma = self.calibration.estimator.estimates(view.timing)["depth_delay"]
        return np.asarray((mean**2 + sigma**2) * (np.outer(velocity, velocity) + covariance + self._prior.reference_covariance))

    def follow(self, view: Keyframe, alignment: Alignment) -> None:
        """Rectifies a view by the velocity that was estimated with its pose."""
        if alignment.joint is not None and view.rectification is not None and alignment.status is not Status.LOST:
            self._rectify(view, view.rectification.times, alignment.joint.velocity, alignment.T_wc)

    def accept(self, view: Keyframe, tracked: Tracked, references: Sequence[Keyframe]) -> None:
        """Learns from the final result for a view: its velocity, and the sensor's times."""
        if self._raw is not None and self._prior is not None:
            self._accept(view, tracked, references, self._prior)
        self._raw, self._prior, self._reference_covariance = None, None, None

    def _accept(self, view: Keyframe, tracked: Tracked, references: Sequence[Keyframe], prior: MotionPrior) -> None:
        assert self._raw is not None and self._reference_covariance is not None
        if tracked.is_lost or not tracked.continues_motion:
            self.motion.stop()
            self.calibration.forget_last()
            self._before = None
            return
        joint, passage = None if tracked.alignment is None else tracked.alignment.joint, self.motion.passage(view.timestamp)
        if joint is not None:
            smoothed = self.motion.accept(view.timestamp, tracked.T_wc, joint.velocity, joint.covariance, prior)
        else:
            smoothed = self.motion.accept_pose(view.timestamp, tracked.T_wc, prior)
        if self._before is None:
            self._start(view, tracked.T_wc, references)
        self.smoother.add(view.index, self.motion.filtered(tracked.T_wc, passage))
        self._learn_from_before(smoothed, references)
        self._keep_velocity(view, tracked.T_wc)
        self._before = view.index
        if tracked.source is Source.ALIGNED and tracked.status is Status.OK and self.motion.is_continuous:
            self.calibration.observe(self._raw, view, tracked.T_wc, self.motion.velocity, references, self._reference_covariance)

    def _start(self, view: Keyframe, T_wc: Tensor, references: Sequence[Keyframe]) -> None:
        """Gives the keyframe just before a view at `T_wc` (4, 4) the velocity of the motion between the two, if it has none."""
        for keyframe in references:
            if keyframe.velocity is None and keyframe.index == view.index - 1 and view.timestamp > keyframe.timestamp:
                self.motion.start(keyframe.T_wk, T_wc, view.timestamp - keyframe.timestamp)
                self._keep_velocity(keyframe, keyframe.T_wk)

    def rectify_first(self, first: Keyframe, view: Keyframe, T_wc: Tensor) -> bool:
        """Rectifies the first keyframe by the motion to the second frame, `view`, which was registered with it at `T_wc` (4, 4).

        Returns whether it was rectified. Then the map has to learn it again.
        """
        elapsed, times = view.timestamp - first.timestamp, self.calibration.times(first)
        if first.rectification is not None or elapsed <= 0 or times.synchronised:
            return False
        self.motion.start(first.T_wk, T_wc, elapsed)
        self._keep_velocity(first, first.T_wk)
        return self.keyframes.rectify(first)

    def _keep_velocity(self, view: Keyframe, T_wc: Tensor) -> None:
        give_velocity(view, T_wc, self.motion.velocity, self.motion.velocity_covariance)

    @staticmethod
    def _rectify(view: Keyframe, times: RowTimes, velocity: Array, T_wc: Tensor) -> None:
        view.rectify(Rectification(times, along_camera(T_wc, velocity)))

    def _learn_from_before(self, smoothed: Smoothed | None, references: Sequence[Keyframe]) -> None:
        """Learns from the frame before, whose velocity the present frame has improved. It may be the last keyframe."""
        known = None if self._before is None else smoothed
        if known is not None:
            for keyframe in references:
                if keyframe.index == self._before:
                    give_velocity(keyframe, keyframe.T_wk, *known)
        self.calibration.learn(known)
