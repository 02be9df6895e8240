"""Motion compensation: a frame of a moving camera has a velocity, which is estimated with its pose and rectifies its images.

A rolling shutter and depth of another moment distort a frame by its velocity. Kerl, Stückler and Cremers, "Dense continuous-time tracking
and mapping with rolling shutter RGB-D cameras" (ICCV 2015) model the same by splines.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from idfslam.alignment.aligner import MapAligner
from idfslam.alignment.alignment import Alignment
from idfslam.alignment.continuous_motion import ContinuousMotion, MotionPrior, Smoothed
from idfslam.alignment.frame_motion import FrameMotion
from idfslam.alignment.motion_smoother import MotionSmoother
from idfslam.alignment.timing_estimation import MovingFrame, TimingEstimator
from idfslam.frame import Frame, Status
from idfslam.geometry.sensor_timing import SYNCHRONISED, SensorTiming
from idfslam.graph.keyframe import Keyframe
from idfslam.sensing.rectification import Rectification, RowTimes, along_camera, along_world, displacement, turned
from idfslam.slam.tracked import Source, Tracked
from idfslam.storage.state import State, Stateful

log = logging.getLogger(__name__)

Array = NDArray[np.float64]

# All of these were chosen by hand.
# [px] Least displacement in `_TYPICAL` of the difference of a frame's velocity to its references', for the frame to tell about the sensor's
# times, or of a change of these, for a keyframe to be rectified again. More: fewer frames are used, and slow recordings take less time.
_TELLING = 1.0
_TYPICAL = 0.01  # [s] half of a usual read-out time. More: slower motion tells about the times
# [s] Change of an estimated time since stored keyframes were last rectified, from which they are rectified again. More: depth of the first
# keyframes stays longer where wrong times carried it. Less: keyframes are learnt again more often, and lose their landmarks.
_CHANGED = 0.005
# [standard deviations] The same, as far as the estimate is unsure: one that wanders has nothing rectified. Less: as of the former.
_SURELY = 2.0
_NAMES = "readout", "depth_readout", "depth_delay"


class MotionCompensation(Stateful):
    """Gives the frames of a front end their velocities, rectifies them, and estimates the sensor's unknown times.

    A frame of a synchronised global shutter passes unchanged.
    """

    def __init__(self, aligner: MapAligner) -> None:
        self.aligner = aligner
        self.motion, self.timing, self.smoother = ContinuousMotion(), TimingEstimator(), MotionSmoother()
        self._raw: Frame | None = None  # the present frame as it was taken; None: its sensor is stated to be synchronised
        self._prior: MotionPrior | None = None  # of the present frame's motion
        self._reference_covariance: Array | None = None  # (6, 6) of the velocities that the present references were rectified with
        self._told: MovingFrame | None = None  # what the frame before tells of the times
        self._running: Future[MovingFrame] | None = None  # the same, while it is worked out beside what follows
        self._pool = ThreadPoolExecutor(1, "times")
        self._before: int | None = None  # index of the frame before, if it has a velocity
        self._stated = SYNCHRONISED  # the times that the frames state
        self._rectified_with: dict[str, float] = {}  # estimates [s] when stored keyframes were last rectified

    def state(self) -> State:
        """The times that the last frame stated, what it tells of those that it does not, and those that stored keyframes have."""
        self._settle()
        told = None if self._told is None else self._told.state()
        stated = list(vars(self._stated).values())
        return {"stated": stated, "before": self._before, "told": told, "rectified_with": dict(self._rectified_with)}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._stated, self._before = SensorTiming(*state["stated"]), state["before"]
        self._told = None if state["told"] is None else MovingFrame.of(state["told"])
        self._rectified_with = dict(state["rectified_with"])

    def begin(self, view: Keyframe, T_last: Tensor, references: Sequence[Keyframe]) -> MotionPrior | None:
        """Gives a view its predicted velocity and pose. T_last (4, 4): of the frame before, as the graph has it.

        references: the keyframes that it is aligned to.
        Returns the prior of its motion. None: all its rows have one time, as far as is known, and the view is unchanged.
        """
        self._raw, self._prior = None, None
        if view.taken.frame.synchronised:
            return None
        self._raw, self._stated = view.taken.frame, view.taken.frame.timing
        self.motion.follow(T_last)
        return self.begin_again(view, references)

    def begin_again(self, view: Keyframe, references: Sequence[Keyframe]) -> MotionPrior | None:
        """The same with the present view, after the motion has become known."""
        assert self._raw is not None
        prior, times = self.motion.predict(view.timestamp, view.T_wk), self.times(view)
        by_times = self._timing_error(prior.velocity, times, references)
        errors = [_velocity_error(k) for k in references if k.velocity is not None]
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
        known = view.timing.depth_delay is not None or not self.times(view).synchronised
        if self._prior is None or known or not self.motion.is_of_a_hand:
            return None
        of_references, covariance = _mean_velocity(references), np.linalg.inv(self._prior.information)[6:, 6:]
        velocity = self._prior.velocity - (0.0 if of_references is None else of_references)
        mean, sigma = self.timing.estimates(view.timing)["depth_delay"]
        return np.asarray((mean**2 + sigma**2) * (np.outer(velocity, velocity) + covariance + self._prior.reference_covariance))

    def _timing_error(self, velocity: Array, times: RowTimes, references: Sequence[Keyframe]) -> Array:
        """(6, 6) second moments, along world axes, of an error of velocity that distorts a frame as the error of the sensor's times does.

        A frame is distorted by its times times its velocity against the references. So a share of the times is a share of that velocity.
        """
        share = self.timing.relative_error(self._stated, times)
        of_references = _mean_velocity(references)
        if not share or of_references is None:
            return np.zeros((6, 6))
        since_references = velocity - of_references
        return share**2 * np.outer(since_references, since_references)

    def follow(self, view: Keyframe, alignment: Alignment) -> None:
        """Rectifies a view by the velocity that was estimated with its pose."""
        if alignment.joint is not None and view.rectification is not None and alignment.status is not Status.LOST:
            self._rectify(view, view.rectification.times, alignment.joint.velocity, alignment.T_wc)

    def accept(self, view: Keyframe, tracked: Tracked, references: Sequence[Keyframe]) -> bool:
        """Learns from the final result for a view: its velocity, and the sensor's times.

        Returns whether one of these is known now, or known so much better that stored keyframes have to be rectified.
        """
        if self._raw is not None and self._prior is not None:
            self._accept(view, tracked, references, self._prior)
        self._raw, self._prior, self._reference_covariance = None, None, None
        now = self.figures() or {}
        if not self._are_news(now):
            return False
        self._rectified_with = now
        found = ", ".join(f"{name} {1000 * value:.0f} ms" for name, value in now.items())
        log.info("frame %d: the sensor's times are estimated: %s", view.index, found)
        return True

    def _are_news(self, now: Mapping[str, float]) -> bool:
        """Whether an estimate [s] is used, and stored keyframes were rectified without it or with quite another one."""
        then, deviations = self._rectified_with, {name: sigma for name, (_, sigma) in (self.estimates() or {}).items()}
        least = {name: max(_CHANGED, _SURELY * deviations.get(name, 0.0)) for name in now}
        return any(value and (not then.get(name) or abs(value - then[name]) > least[name]) for name, value in now.items())

    def _accept(self, view: Keyframe, tracked: Tracked, references: Sequence[Keyframe], prior: MotionPrior) -> None:
        assert self._raw is not None
        if tracked.is_lost or not tracked.continues_motion:
            self.motion.stop()
            self._told, self._running, self._before = None, None, None
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
        tells = tracked.source is Source.ALIGNED and tracked.status is Status.OK and self.motion.is_continuous
        if tells and None in vars(self._raw.timing).values() and (told := self._told_by(view, tracked.T_wc, references)) is not None:
            self._running = self._pool.submit(told)

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
        elapsed, times = view.timestamp - first.timestamp, self.times(first)
        if first.rectification is not None or elapsed <= 0 or times.synchronised:
            return False
        self.motion.start(first.T_wk, T_wc, elapsed)
        self._keep_velocity(first, first.T_wk)
        return self.rectify_stored(first)

    def rectify_stored(self, keyframe: Keyframe) -> bool:
        """Rectifies a keyframe of the time before the sensor's times were known as they are now. Returns whether its images have changed.

        Then the map has to learn it again.
        """
        times = self.times(keyframe)
        if keyframe.velocity is None or times.synchronised:
            return False
        if (done := keyframe.rectification) is None:
            keyframe.rectify(Rectification(times, keyframe.velocity))
        elif displacement(keyframe.frame, done.velocity, float(np.abs(times.array - done.times.array).max())) < _TELLING:
            return False
        else:
            keyframe.rectify_further(times)
        self.aligner.appearances.forget(keyframe)
        return True

    def _keep_velocity(self, view: Keyframe, T_wc: Tensor) -> None:
        _give_velocity(view, T_wc, self.motion.velocity, self.motion.velocity_covariance)

    def times(self, keyframe: Keyframe) -> RowTimes:
        """The times of the rows of a keyframe's images, as they were taken: stated, estimated, or zero."""
        return self.timing.of(keyframe.timing, keyframe.depth_lag)

    def likeliest_times(self, keyframe: Keyframe) -> tuple[RowTimes, Array]:
        """The same with estimates that are not significant, and standard deviations (3,) [s]: zero until the motion tells of them."""
        found = self.estimates() or {}
        sigmas = np.array([found[name][1] if name in found else 0.0 for name in _NAMES])
        return (self.timing.likeliest(keyframe.timing, keyframe.depth_lag) if found else self.times(keyframe)), sigmas

    @staticmethod
    def _rectify(view: Keyframe, times: RowTimes, velocity: Array, T_wc: Tensor) -> None:
        view.rectify(Rectification(times, along_camera(T_wc, velocity)))

    def _learn_from_before(self, smoothed: Smoothed | None, references: Sequence[Keyframe]) -> None:
        """Learns from the frame before, whose velocity the present frame has improved. It may be the last keyframe."""
        self._settle()
        told, self._told = self._told, None
        if smoothed is None or self._before is None:
            return
        velocity, covariance = smoothed
        for keyframe in references:
            if keyframe.index == self._before:
                _give_velocity(keyframe, keyframe.T_wk, velocity, covariance)
        if told is not None:
            self.timing.add(told, velocity, covariance, self._stated)

    def _settle(self) -> None:
        """Waits for what the frame before tells of the times."""
        if self._running is not None:
            self._told, self._running = self._running.result(), None

    def _told_by(self, view: Keyframe, T_wc: Tensor, references: Sequence[Keyframe]) -> Callable[[], MovingFrame] | None:
        """What a view tells of the unknown times once its velocity is known better; None if it hardly moves against its references.

        It is worked out when it is called, in this thread or another.
        """
        assert self._raw is not None and self._reference_covariance is not None
        of_references, velocity = _mean_velocity(references), self.motion.velocity
        if of_references is None:
            return None
        if displacement(self._raw, velocity - of_references, _TYPICAL) < _TELLING:
            return None
        times = RowTimes() if view.rectification is None else view.rectification.times
        lag = 0.0 if view.rectification is None else self._raw.depth_lag
        depth, images = self.aligner.row_moments(view, T_wc, references, FrameMotion(times, velocity))
        with_velocities = times, lag, velocity, of_references, self._reference_covariance
        return lambda: MovingFrame(depth, images(), *with_velocities)

    def figures(self) -> dict[str, float] | None:
        """The estimates of the unknown times [s] by name, to a tenth of a millisecond, 0 where not significant; None if none is."""
        found = dict(zip(_NAMES, self.timing.timing(self._stated)))
        unknown = {name: round(found[name], 4) for name, stated in vars(self._stated).items() if stated is None}
        return unknown if any(unknown.values()) else None

    def estimates(self) -> dict[str, tuple[float, float]] | None:
        """Value and standard deviation [s] of the unknown times by name, significant or not; None without any, or before they are told."""
        return self.timing.estimates(self._stated) or None if self.timing.has_seen_motion else None


def _give_velocity(view: Keyframe, T_wc: Tensor, velocity: Array, covariance: Array) -> None:
    """Gives a view at `T_wc` (4, 4) a velocity (6,) along world axes, with its covariance (6, 6)."""
    view.velocity = along_camera(T_wc, velocity)
    view.velocity_covariance = turned(T_wc[:3, :3].T.numpy(), covariance)


def _mean_velocity(references: Sequence[Keyframe]) -> Array | None:
    """(6,) along world axes, of the keyframes that have one; None if none has."""
    velocities = [along_world(k.T_wk, k.velocity) for k in references if k.velocity is not None]
    return np.asarray(np.mean(velocities, 0)) if velocities else None


def _velocity_error(keyframe: Keyframe) -> Array:
    """(6, 6) second moments, along world axes, of the velocity that a keyframe's images are still distorted by."""
    assert keyframe.velocity is not None and keyframe.velocity_covariance is not None
    left = keyframe.velocity if keyframe.rectification is None else keyframe.velocity - keyframe.rectification.velocity
    left = along_world(keyframe.T_wk, left)
    return np.asarray(turned(keyframe.T_wk[:3, :3].numpy(), keyframe.velocity_covariance) + np.outer(left, left))
