"""The search for a view's pose: alignments to the map from several guesses, one after the other, until one convinces."""

from collections.abc import Sequence
from enum import Enum

from torch import Tensor

from idfslam.alignment.aligner import MapAligner
from idfslam.alignment.alignment import Alignment
from idfslam.alignment.continuous_motion import MotionPrior
from idfslam.alignment.image_rotation import turned
from idfslam.alignment.motion import image_motion
from idfslam.alignment.small_image import pixels_of, small_image
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.keyframe_selection import WIDE
from idfslam.slam.front_end.motion_compensation import MotionCompensation
from idfslam.slam.front_end.recent_frame import RecentFrame
from idfslam.slam.front_end.registered_pose import RegisteredPose
from idfslam.slam.front_end.registration import Registration
from idfslam.slam.stage_timer import StageTimer

# [1] Least ratio of the score of a later guess to the best score for it to replace the best. More: the predicted motion wins more often
# where all guesses score about the same. Chosen by hand.
_BETTER = 1.05


class Guess(Enum):
    """A pose that an alignment starts at."""

    PREDICTED = "predicted"  # by the motion model
    REGISTERED = "registered"  # by the neural tracker
    LAST = "last"  # of the frame before
    TURNED = "turned"  # the best pose so far, turned as the image of the last keyframe shows, wherever the frame before was


class PoseSearch:
    """Aligns a view from the predicted pose.

    If the result is doubtful, or far from the prediction, it is aligned from the other guesses too, in the order of `Guess`, until one
    convinces.
    """

    def __init__(
        self,
        aligner: MapAligner,
        registration: Registration,
        graph: KeyframeGraph,
        frames: FramePoses,
        timer: StageTimer,
        compensation: MotionCompensation,
        recent: RecentFrame,
    ) -> None:
        self.aligner, self.registration, self.graph, self.frames, self.timer = aligner, registration, graph, frames, timer
        self.compensation, self.recent = compensation, recent

    def best(self, view: Keyframe, motion: MotionPrior | None) -> tuple[Alignment, RegisteredPose | None]:
        """The best alignment of a view at its predicted pose; and the registered pose if the tracker was asked and gave one."""
        best: Alignment | None = None
        registered: RegisteredPose | None = None
        for guess, max_guess_error_px in self._guesses():
            T_guess, prior = (view.T_wk if guess is Guess.PREDICTED else self.frames.last_pose(view.T_wk)), motion
            if guess is Guess.REGISTERED:
                registered = self.registration.register(view, near=self._probable(best))
                if registered is None:
                    continue
                T_guess, prior = registered.T_wc, None if motion is None else registered.prior(motion)
            if guess is Guess.TURNED:
                if best is None or not self.aligner.contradicts_images(best):
                    break
                T_guess = self._turned(view, best.T_wc)
            aligned = self._align(view, T_guess, max_guess_error_px, prior)
            if best is None or self._is_better(view, aligned, best, registered, has_patches=prior is not motion):
                best = aligned
            if guess is Guess.PREDICTED and (self.frames.in_doubt or self.aligner.is_far(aligned, T_guess)):
                continue  # the tracker is asked in any case
            if not self.aligner.is_doubtful(best) and not self.aligner.unexpected(aligned, T_guess, max_guess_error_px):
                break
        assert best is not None
        return best, registered

    def step(self, view: Keyframe, T_wc: Tensor, radius: float) -> float:
        """Motion of the image [rad] since the frame before, or since its prediction if that is more. radius: the scene's distance [m].

        0 for a rectified view: where its velocity was predicted wrongly its image is bent, and patches tell little of its pose.
        """
        if view.rectification is not None:
            return 0.0
        return max(image_motion(T, T_wc, radius) for T in (view.T_wk, self.frames.last_pose(view.T_wk)))

    def references(self) -> Sequence[Keyframe]:
        """The keyframes whose images a view is compared with."""
        return self.graph.references(self.aligner.config.references)

    def _guesses(self) -> list[tuple[Guess, float | None]]:
        """The guesses in order, each with a bound on its error [px]: the predicted pose with and without a bound, registered, last pose."""
        expected = self.aligner.expected
        nearby = [] if expected is None else [(Guess.PREDICTED, expected)]
        return [*nearby, (Guess.PREDICTED, None), (Guess.REGISTERED, None), (Guess.LAST, None), (Guess.TURNED, None)]

    def _probable(self, aligned: Alignment | None) -> Tensor | None:
        """The pose (4, 4) of an alignment that is not in doubt, but far from where the frame was expected; otherwise None."""
        return None if aligned is None or self.frames.in_doubt or self.aligner.is_doubtful(aligned) else aligned.T_wc

    def _align(self, view: Keyframe, T_guess: Tensor, max_guess_error_px: float | None, motion: MotionPrior | None) -> Alignment:
        with self.timer.stage("align"):
            return self.aligner.align(
                view,
                T_guess,
                self.references(),
                max_guess_error_px=max_guess_error_px,
                motion=motion,
                recent=None if view.moving is not None else self.recent.reference(),  # it may show what moves, too
                displaced_by=self.compensation.depth_displacement(view, self.references()),
            )

    def _turned(self, view: Keyframe, T_wc: Tensor) -> Tensor:
        """A view's pose (4, 4), turned as the small images of it and of the last keyframe show."""
        last, appearances = self.references()[0], self.aligner.appearances
        seen = pixels_of(small_image(appearances.of(last)))
        appearances.release(last)
        return turned(small_image(appearances.as_taken(view)), seen, T_wc, last.T_wk)

    def _is_better(
        self, view: Keyframe, aligned: Alignment, best: Alignment, registered: RegisteredPose | None, *, has_patches: bool
    ) -> bool:
        """Whether an alignment beats the best so far: by its score, or in a wide step because the registration refutes only that one.

        has_patches: it weighs the registration's patches as well as depth and brightness. Where the scores say neither, it is the better.
        """
        if registered is not None and self.step(view, registered.T_wc, aligned.radius) > WIDE:
            refuted = registered.refutes(aligned), registered.refutes(best)
            if refuted[0] != refuted[1]:
                return refuted[1]
        return aligned.score > (1 / _BETTER if has_patches else _BETTER) * best.score
