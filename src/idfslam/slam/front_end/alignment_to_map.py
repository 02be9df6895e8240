"""Alignment to the map: the fast preset's front end, which asks the neural tracker too.

Each frame is aligned to the map and to keyframe images. If the result is in doubt or far from the predicted pose, it is registered with a
keyframe (Sec. V). In wide steps, the patches that both must project decide between the two.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from idfslam.alignment.aligner import MapAligner
from idfslam.alignment.alignment import TELLING_SHARE, Alignment
from idfslam.alignment.continuous_motion import MotionPrior
from idfslam.alignment.image_rotation import ImageRotation
from idfslam.alignment.motion import image_motion
from idfslam.frame import Status
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.keyframe_selection import WIDE
from idfslam.sensing.rectification import RowTimes
from idfslam.slam.front_end.front_end import FrontEnd
from idfslam.slam.front_end.motion_compensation import MotionCompensation
from idfslam.slam.front_end.pose_search import PoseSearch
from idfslam.slam.front_end.recent_frame import RecentFrame
from idfslam.slam.front_end.registered_pose import RegisteredPose, are_apart
from idfslam.slam.front_end.registration import Registration
from idfslam.slam.front_end.speed_gate import SpeedGate
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Evidence, Source, Tracked
from idfslam.storage.state import State

# [1] Ratio of the image's displacement at a registered pose, whose patches refute the aligned one, to that at the aligned pose, below which
# the registered one is taken. Above its inverse the aligned one stands, and between them the image decides nothing. More: wrong alignments
# are left sooner, and registrations that are no better are taken. From the passage of fr1/rpy where alignments ran away: 0.5 to 0.6 before,
# 0.9 where both were about right.
_DISPLACED = 0.8
# [rad] Motion of the image since a repeated colour image was new, below which it still shows what the camera sees: a pixel and a half of
# 320. More: a pose follows depth later while colour is repeated. Chosen by hand.
_STANDS = 0.005


class AlignmentToMap(FrontEnd):
    """Alignment to the map from the predicted pose. In doubt, and far from the prediction, the registered pose is tried too."""

    def __init__(
        self,
        aligner: MapAligner,
        registration: Registration,
        graph: KeyframeGraph,
        frames: FramePoses,
        timer: StageTimer,
        train_now: Callable[[Keyframe], None] = lambda keyframe: None,
        queue_for_training: Callable[[Sequence[Keyframe]], None] = lambda keyframes: None,
        resect: Callable[[Keyframe, Alignment], Alignment] = lambda view, aligned: aligned,
    ) -> None:
        """train_now: trains the map on the first keyframe before the next frame, after its images were rectified.

        queue_for_training: keyframes whose images have changed, for the updates that follow.

        resect: holds the pose of an alignment where depth is scarce, by corners of keyframes.
        """
        self.aligner, self.registration, self.graph, self.frames, self.timer = aligner, registration, graph, frames, timer
        self.compensation, self._train_now, self._queue_for_training = MotionCompensation(aligner), train_now, queue_for_training
        self.rotation, self.recent, self.gate = ImageRotation(), RecentFrame(aligner, frames), SpeedGate(frames)
        self.search = PoseSearch(aligner, registration, graph, frames, timer, self.compensation, self.recent)
        self._resect = resect
        self.evidence = Evidence()  # evidence for the last frame's pose

    def state(self) -> State:
        """The evidence for the last pose."""
        return {"evidence": vars(self.evidence).copy()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.evidence = Evidence(**state["evidence"])

    def track(self, view: Keyframe) -> Tracked:
        motion = self._begin(view)
        if self.graph.lacks_colour(view) and (by_depth := self._by_depth(view, motion)) is not None:
            return by_depth
        self._turn(view)
        by_map, registered = self.search.best(view, motion)
        aligned = self._resect(view, by_map)
        wide = registered is not None and self.search.step(view, registered.T_wc, aligned.radius) > WIDE
        contested = False
        if registered is not None and registered.refutes(aligned):
            displaced = self._displaced(view, registered, aligned)
            if wide or displaced < _DISPLACED:
                return self._registered(view, registered, aligned, wide=wide)
            contested = displaced <= 1 / _DISPLACED and registered.is_apart(aligned)
        self.compensation.follow(view, aligned)
        if aligned.status is Status.LOST:
            return self._unmatched(view, registered)
        confirmed = registered is not None and registered.confirms(aligned, wide=wide)
        if self._ran_away(view, aligned, confirmed=confirmed):
            return replace(Tracked.aligned(aligned, Source.PREDICTED, doubtful=True, clear=False), T_wc=view.T_wk, alignment=None)
        tracked = self._aligned(view, aligned, confirmed=confirmed, wide=wide, contested=contested)
        return replace(tracked, alignment=by_map)  # without corners, which are asked again at the end of a run

    def _turn(self, view: Keyframe) -> None:
        """Turns the predicted pose of a view as two small images show."""
        T_seen = self.frames.T_wc(self.rotation.index) if self.rotation.index >= 0 else view.T_wk
        view.T_wk = self.rotation.correct(self.aligner.appearances.as_taken(view), view.T_wk, T_seen)

    def _by_depth(self, view: Keyframe, motion: MotionPrior | None) -> Tracked | None:
        """The pose by depth alone, for a view without a colour image of its own; None if depth finds none, or the camera has not moved
        since a repeated image was new.

        It is doubtful if the frame before was, if depth leaves a direction open, or if it leaps: no image can settle that.
        """
        with self.timer.stage("align"):
            aligned = self.aligner.align(view, view.T_wk, [], motion=motion)
        if aligned.status is Status.LOST or (not view.is_clipped and self._stands(view, aligned)):
            return None
        self.compensation.follow(view, aligned)
        doubtful = self.frames.in_doubt or aligned.status is Status.DEGENERATE or self.gate.is_leap(view.timestamp, aligned.T_wc)
        tracked = Tracked.aligned(aligned, doubtful=doubtful, clear=False)
        return replace(tracked, evidence=replace(tracked.evidence, in_view=self.evidence.in_view))  # as of the last new image

    def _stands(self, view: Keyframe, aligned: Alignment) -> bool:
        """Whether the camera has not moved since a colour image that is repeated was new."""
        return image_motion(self.frames.T_wc(view.colour_since), aligned.T_wc, aligned.radius) < _STANDS

    def _ran_away(self, view: Keyframe, aligned: Alignment, *, confirmed: bool) -> bool:
        """Whether a pose that nothing measures is far from the predicted one: with a few readings an alignment may run away."""
        return self._is_unmeasured(aligned, confirmed=confirmed) and are_apart(view.T_wk, aligned.T_wc)

    def _is_unmeasured(self, aligned: Alignment, *, confirmed: bool) -> bool:
        """Whether a pose is expected to be far off, and neither the image nor a registration tells."""
        return not confirmed and aligned.is_unsure and _is_unseen(aligned)

    def _aligned(self, view: Keyframe, aligned: Alignment, *, confirmed: bool, wide: bool, contested: bool) -> Tracked:
        """The aligned pose, and whether it is in doubt.

        confirmed: a registration says that it is right: then landmarks that lie elsewhere have moved. wide: that was in a wide step.
        contested: one says that it is wrong, and the image says neither.
        """
        goes_on = self.frames.in_doubt and not confirmed and _is_unseen(aligned)  # nothing ends the doubt
        leaps = self.gate.is_leap(view.timestamp, aligned.T_wc)
        undecided = contested or goes_on or leaps or self._is_unmeasured(aligned, confirmed=confirmed)
        view.registered = confirmed and wide and not undecided
        doubtful = undecided or (self.aligner.doubt.has_usual and self.aligner.contradicts_images(aligned) and not confirmed)
        clear = view.registered or self.aligner.is_clear(aligned)
        tracked = Tracked.aligned(aligned, doubtful=doubtful, clear=clear)
        return replace(tracked, evidence=replace(tracked.evidence, step=self.search.step(view, aligned.T_wc, aligned.radius)))

    def _unmatched(self, view: Keyframe, registered: RegisteredPose | None) -> Tracked:
        """The result for a view that matches the map nowhere: the registered pose, of which nobody is sure, or none."""
        evidence = replace(self.evidence, least_information=0.0)
        if registered is None:
            return Tracked(view.T_wk, Status.LOST, Source.PREDICTED, evidence)
        return Tracked(registered.T_wc, Status.OK, Source.REGISTERED, evidence, confident=False, covariance=registered.covariance)

    def _displaced(self, view: Keyframe, registered: RegisteredPose, aligned: Alignment) -> float:
        """The image's displacement at a registered pose over that at an aligned one; 1 if either is unknown."""
        at_registered = self.aligner.displacement(view, registered.T_wc, self.search.references())
        return at_registered / aligned.displacement if at_registered and aligned.displacement else 1.0

    def _registered(self, view: Keyframe, registered: RegisteredPose, aligned: Alignment, *, wide: bool) -> Tracked:
        """The registered pose outright: the image refutes that by the map, which has learnt too little here, or depth's errors.

        It is in doubt where nothing else confirms it yet, where it is far from the aligned one and not sure itself, or where no hand is so
        fast.
        """
        leaps = self.gate.is_leap(view.timestamp, registered.T_wc)
        view.registered = wide and not leaps
        found = self.aligner.evidence(view, registered.T_wc, self.search.references())
        evidence = Evidence(found.in_view, found.overlap, self.search.step(view, found.T_wc, found.radius))
        unconfirmed = self.frames.in_doubt or (registered.is_apart(aligned) and not registered.is_sure)
        status = Status.DOUBTFUL if leaps or (unconfirmed and not wide) else Status.OK
        return Tracked(registered.T_wc, status, Source.REGISTERED, evidence, found, covariance=registered.covariance)

    def accept(self, view: Keyframe, tracked: Tracked) -> None:
        self.evidence = tracked.evidence
        self.rotation.accept(view.index, lost=tracked.is_lost)
        self.gate.accept(view.index, view.timestamp, tracked)
        self.recent.accept(view, tracked, self.search.references())
        if tracked.alignment is not None:
            self.aligner.accept(tracked.alignment, view.T_wk)
        self.compensation.accept(view, tracked, self.search.references())
        if self.compensation.keyframes.is_due(view.index):
            self._queue_for_training([k for k in self.graph.keyframes if self.compensation.keyframes.rectify(k)])

    def misfit(self, view: Keyframe, T_wc: Tensor) -> float:
        return self.aligner.evidence(view, T_wc, self.search.references()).photometric_error

    def row_times(self, keyframe: Keyframe) -> RowTimes:
        return self.compensation.calibration.times(keyframe)

    def likeliest_row_times(self, keyframe: Keyframe) -> tuple[RowTimes, NDArray[np.float64]]:
        return self.compensation.calibration.likeliest_times(keyframe)

    def smooth(self) -> None:
        self.compensation.smoother.smooth(self.frames)

    def undo(self) -> Callable[[], None]:
        kept = [(part, vars(part).copy()) for part in (self.rotation, self.compensation, self.compensation.motion)]
        drawn = [(generator, generator.get_state()) for generator in (self.aligner.generator, self.registration.tracker.generator)]

        def undo() -> None:
            for part, values in kept:
                vars(part).update(values)
            for generator, state in drawn:
                generator.set_state(state)

        return undo

    def figures(self) -> dict[str, Any]:
        calibration = self.compensation.calibration
        return {"sensor_timing": calibration.used(), "sensor_timing_estimates": calibration.estimates()}

    def _begin(self, view: Keyframe) -> MotionPrior | None:
        """Rectifies the view by its predicted velocity, and the first keyframe before it if the view is the second frame."""
        motion = self.compensation.begin(view, self.frames.last_pose(view.T_wk), self.search.references())
        first = self.graph.keyframes[0]
        if motion is None or len(self.graph.keyframes) > 1 or len(self.frames) != first.index + 1:
            return motion
        registered = self.registration.register(view)
        if registered is None or not self.compensation.rectify_first(first, view, registered.T_wc):
            return motion
        self._train_now(first)
        return self.compensation.begin_again(view, self.search.references())


def _is_unseen(aligned: Alignment) -> bool:
    """Whether the image is no evidence for a pose: hardly anything that the keyframes know is in view."""
    return not aligned.displacement or aligned.in_view < TELLING_SHARE
