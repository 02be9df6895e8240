"""Alignment to the map: the fast preset's front end, which asks the neural tracker too.

Each frame is aligned to the map and to keyframe images. If the result is in doubt or far from the predicted pose, it is registered with a
keyframe (Sec. V). In wide steps, the patches that both must project decide between the two.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from idfslam.alignment.aligner import MapAligner
from idfslam.alignment.alignment import TELLING_SHARE, Alignment
from idfslam.alignment.continuous_motion import MotionPrior
from idfslam.alignment.image_rotation import ImageRotation, turned
from idfslam.alignment.motion import image_motion
from idfslam.alignment.small_image import pixels_of, small_image
from idfslam.frame import Status
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.keyframe_selection import WIDE
from idfslam.sensing.rectification import RowTimes
from idfslam.slam.front_end.front_end import FrontEnd
from idfslam.slam.front_end.motion_compensation import MotionCompensation
from idfslam.slam.front_end.recent_frame import RecentFrame
from idfslam.slam.front_end.registered_pose import RegisteredPose, are_apart
from idfslam.slam.front_end.registration import Registration
from idfslam.slam.front_end.speed_gate import SpeedGate
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Evidence, Source, Tracked
from idfslam.storage.state import State

# [1] Least ratio of the score of a later guess to the best score for it to replace the best. More: the predicted motion wins more often
# where all guesses score about the same. Chosen by hand.
_BETTER = 1.05
# [1] Ratio of the image's displacement at a registered pose, whose patches refute the aligned one, to that at the aligned pose, below which
# the registered one is taken. Above its inverse the aligned one stands, and between them the image decides nothing. More: wrong alignments
# are left sooner, and registrations that are no better are taken. From the passage of fr1/rpy where alignments ran away: 0.5 to 0.6 before,
# 0.9 where both were about right.
_DISPLACED = 0.8
# [rad] Motion of the image since a repeated colour image was new, below which it still shows what the camera sees: a pixel and a half of
# 320. More: a pose follows depth later while colour is repeated. Chosen by hand.
_STANDS = 0.005


class _Guess(Enum):
    """A pose that an alignment starts at."""

    PREDICTED = "predicted"  # by the motion model
    REGISTERED = "registered"  # by the neural tracker
    LAST = "last"  # of the frame before
    TURNED = "turned"  # the best pose so far, turned as the image of the last keyframe shows, wherever the frame before was


class AlignmentToMap(FrontEnd):
    """Alignment to the map from the predicted pose. In doubt, and far from the prediction, the registered pose is tried too."""

    def __init__(
        self,
        aligner: MapAligner,
        registration: Registration,
        graph: KeyframeGraph,
        frames: FramePoses,
        timer: StageTimer,
        learn_again: Callable[[Keyframe], None] = lambda keyframe: None,
        relearn: Callable[[Sequence[Keyframe]], None] = lambda keyframes: None,
        resect: Callable[[Keyframe, Alignment], Alignment] = lambda view, aligned: aligned,
    ) -> None:
        """learn_again: has the map learn the first keyframe again at once, after its images were rectified. relearn: several, by and by.

        resect: holds the pose of an alignment where depth is scarce, by corners of keyframes.
        """
        self.aligner, self.registration, self.graph, self.frames, self.timer = aligner, registration, graph, frames, timer
        self.compensation, self._learn_again, self._relearn = MotionCompensation(aligner), learn_again, relearn
        self.rotation, self.recent, self.gate = ImageRotation(), RecentFrame(aligner, frames), SpeedGate(frames)
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
        by_map, registered = self._best_alignment(view, motion)
        aligned = self._resect(view, by_map)
        wide = registered is not None and self._step(view, registered.T_wc, aligned.radius) > WIDE
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
        """The result of depth alone for a view without colour: nothing ends a doubt, or helps depth that is degenerate.

        None where depth does not tell, or the camera has not moved since an image that is repeated was new.
        """
        with self.timer.stage("align"):
            aligned = self.aligner.align(view, view.T_wk, [], motion=motion)
        if aligned.status is Status.LOST or (not view.is_clipped and self._stands(view, aligned)):
            return None
        self.compensation.follow(view, aligned)
        doubtful = self._in_doubt or aligned.status is Status.DEGENERATE or self.gate.is_leap(view.timestamp, aligned.T_wc)
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
        goes_on = self._in_doubt and not confirmed and _is_unseen(aligned)  # nothing ends the doubt
        leaps = self.gate.is_leap(view.timestamp, aligned.T_wc)
        undecided = contested or goes_on or leaps or self._is_unmeasured(aligned, confirmed=confirmed)
        view.registered = confirmed and wide and not undecided
        doubtful = undecided or (self.aligner.doubt.has_usual and self.aligner.contradicts_images(aligned) and not confirmed)
        clear = view.registered or self.aligner.is_clear(aligned)
        tracked = Tracked.aligned(aligned, doubtful=doubtful, clear=clear)
        return replace(tracked, evidence=replace(tracked.evidence, step=self._step(view, aligned.T_wc, aligned.radius)))

    def _unmatched(self, view: Keyframe, registered: RegisteredPose | None) -> Tracked:
        """The result for a view that matches the map nowhere: the registered pose, of which nobody is sure, or none."""
        evidence = replace(self.evidence, least_information=0.0)
        if registered is None:
            return Tracked(view.T_wk, Status.LOST, Source.PREDICTED, evidence)
        return Tracked(registered.T_wc, Status.OK, Source.REGISTERED, evidence, confident=False, covariance=registered.covariance)

    def _step(self, view: Keyframe, T_wc: Tensor, radius: float) -> float:
        """Motion of the image [rad] since the frame before, or since its prediction if that is more. radius: the scene's distance [m].

        0 for a rectified view: where its velocity was predicted wrongly its image is bent, and patches tell little of its pose.
        """
        if view.rectification is not None:
            return 0.0
        return max(image_motion(T, T_wc, radius) for T in (view.T_wk, self._last_pose(view)))

    def _displaced(self, view: Keyframe, registered: RegisteredPose, aligned: Alignment) -> float:
        """The image's displacement at a registered pose over that at an aligned one; 1 if either is unknown."""
        at_registered = self.aligner.displacement(view, registered.T_wc, self._references())
        return at_registered / aligned.displacement if at_registered and aligned.displacement else 1.0

    def _registered(self, view: Keyframe, registered: RegisteredPose, aligned: Alignment, *, wide: bool) -> Tracked:
        """The registered pose outright: the image refutes that by the map, which has learnt too little here, or depth's errors.

        It is in doubt where nothing else confirms it yet, where it is far from the aligned one and not sure itself, or where no hand is so
        fast.
        """
        leaps = self.gate.is_leap(view.timestamp, registered.T_wc)
        view.registered = wide and not leaps
        found = self.aligner.evidence(view, registered.T_wc, self._references())
        evidence = Evidence(found.in_view, found.overlap, self._step(view, found.T_wc, found.radius))
        unconfirmed = self._in_doubt or (registered.is_apart(aligned) and not registered.is_sure)
        status = Status.DOUBTFUL if leaps or (unconfirmed and not wide) else Status.OK
        return Tracked(registered.T_wc, status, Source.REGISTERED, evidence, found, covariance=registered.covariance)

    def accept(self, view: Keyframe, tracked: Tracked) -> None:
        self.evidence = tracked.evidence
        self.rotation.accept(view.index, lost=tracked.is_lost)
        self.gate.accept(view.index, view.timestamp, tracked)
        self.recent.accept(view, tracked, self._references())
        if tracked.alignment is not None:
            self.aligner.accept(tracked.alignment, view.T_wk)
        self.compensation.accept(view, tracked, self._references())
        if self.compensation.keyframes.is_due(view.index):
            self._relearn([k for k in self.graph.keyframes if self.compensation.keyframes.rectify(k)])

    def misfit(self, view: Keyframe, T_wc: Tensor) -> float:
        return self.aligner.evidence(view, T_wc, self._references()).photometric_error

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
        motion = self.compensation.begin(view, self._last_pose(view), self._references())
        first = self.graph.keyframes[0]
        if motion is None or len(self.graph.keyframes) > 1 or len(self.frames) != first.index + 1:
            return motion
        registered = self.registration.register(view)
        if registered is None or not self.compensation.rectify_first(first, view, registered.T_wc):
            return motion
        self._learn_again(first)
        return self.compensation.begin_again(view, self._references())

    def _best_alignment(self, view: Keyframe, motion: MotionPrior | None) -> tuple[Alignment, RegisteredPose | None]:
        """The best alignment, of guesses that are tried until one convinces; and the registered pose if the tracker gave one."""
        best: Alignment | None = None
        registered: RegisteredPose | None = None
        for guess, max_guess_error_px in self._guesses():
            T_guess, prior = (view.T_wk if guess is _Guess.PREDICTED else self._last_pose(view)), motion
            if guess is _Guess.REGISTERED:
                registered = self.registration.register(view, near=self._probable(best))
                if registered is None:
                    continue
                T_guess, prior = registered.T_wc, None if motion is None else registered.prior(motion)
            if guess is _Guess.TURNED:
                if best is None or not self.aligner.contradicts_images(best):
                    break
                T_guess = self._turned(view, best.T_wc)
            aligned = self._align(view, T_guess, max_guess_error_px, prior)
            if best is None or self._is_better(view, aligned, best, registered, has_patches=prior is not motion):
                best = aligned
            if guess is _Guess.PREDICTED and (self._in_doubt or self.aligner.is_far(aligned, T_guess)):
                continue  # the tracker is asked in any case
            if not self.aligner.is_doubtful(best) and not self.aligner.unexpected(aligned, T_guess, max_guess_error_px):
                break
        assert best is not None
        return best, registered

    def _probable(self, aligned: Alignment | None) -> Tensor | None:
        """The pose (4, 4) of an alignment that is not in doubt, but far from where the frame was expected; otherwise None."""
        return None if aligned is None or self._in_doubt or self.aligner.is_doubtful(aligned) else aligned.T_wc

    def _align(self, view: Keyframe, T_guess: Tensor, max_guess_error_px: float | None, motion: MotionPrior | None) -> Alignment:
        recent = None if view.moving is not None else self.recent.reference()  # it may show what moves, too
        with self.timer.stage("align"):
            bound, displaced_by = max_guess_error_px, self.compensation.depth_displacement(view, self._references())
            return self.aligner.align(
                view, T_guess, self._references(), max_guess_error_px=bound, motion=motion, recent=recent, displaced_by=displaced_by
            )

    def _guesses(self) -> list[tuple[_Guess, float | None]]:
        """The guesses in order, each with a bound on its error [px]: the predicted pose with and without a bound, registered, last pose."""
        expected = self.aligner.expected
        nearby = [] if expected is None else [(_Guess.PREDICTED, expected)]
        return [*nearby, (_Guess.PREDICTED, None), (_Guess.REGISTERED, None), (_Guess.LAST, None), (_Guess.TURNED, None)]

    def _turned(self, view: Keyframe, T_wc: Tensor) -> Tensor:
        """A view's pose (4, 4), turned as the small images of it and of the last keyframe show."""
        last, appearances = self._references()[0], self.aligner.appearances
        seen = pixels_of(small_image(appearances.of(last)))
        appearances.release(last)
        return turned(small_image(appearances.as_taken(view)), seen, T_wc, last.T_wk)

    def _references(self) -> Sequence[Keyframe]:
        return self.graph.references(self.aligner.config.references)

    @property
    def _in_doubt(self) -> bool:
        """Whether the frame before was doubtful."""
        return len(self.frames) > 0 and self.frames.last_status is Status.DOUBTFUL

    def _last_pose(self, view: Keyframe) -> Tensor:
        return self.frames.T_wc(-1) if len(self.frames) else view.T_wk

    def _is_better(
        self, view: Keyframe, aligned: Alignment, best: Alignment, registered: RegisteredPose | None, *, has_patches: bool
    ) -> bool:
        """Whether an alignment beats the best so far: by its score, or in a wide step because the registration refutes only that one.

        has_patches: it weighs the registration's patches as well as depth and brightness. Where the scores say neither, it is the better.
        """
        if registered is not None and self._step(view, registered.T_wc, aligned.radius) > WIDE:
            refuted = registered.refutes(aligned), registered.refutes(best)
            if refuted[0] != refuted[1]:
                return refuted[1]
        return aligned.score > (1 / _BETTER if has_patches else _BETTER) * best.score


def _is_unseen(aligned: Alignment) -> bool:
    """Whether the image is no evidence for a pose: hardly anything that the keyframes know is in view."""
    return not aligned.displacement or aligned.in_view < TELLING_SHARE
