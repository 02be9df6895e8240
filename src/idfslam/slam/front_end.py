"""The front end: it computes a frame's pose from the keyframes and the map. Each front end is one class; `compose.py` names them.

`Registration` is the paper's (Sec. V). `AlignmentToMap` aligns each frame to the map, and uses the neural tracker only if the result is
doubtful.
"""

from abc import ABC, abstractmethod
from dataclasses import replace
from enum import Enum

import torch
from torch import Tensor

from idfslam.alignment.aligner import Alignment, MapAligner
from idfslam.frame import Status
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Evidence, Source, Tracked
from idfslam.storage.state import State, Stateful
from idfslam.tracking.tracker import Tracker

# [1] Least ratio of the score of a later guess to the best score for it to replace the best. More: the predicted motion wins more often
# where all guesses score about the same. Chosen by hand.
_BETTER = 1.05


class _Guess(Enum):
    """A pose that an alignment starts at."""

    PREDICTED = "predicted"  # by the motion model
    REGISTERED = "registered"  # by the neural tracker
    LAST = "last"  # of the frame before


class FrontEnd(Stateful, ABC):
    """Tracks frames. Another front end must implement `track` only."""

    @abstractmethod
    def track(self, view: Keyframe) -> Tracked:
        """Tracks a view, whose pose is the predicted one. The graph has at least one keyframe."""

    def accept(self, view: Keyframe, tracked: Tracked) -> None:
        """Learns from the final result for a view, after recovery. The view still has its predicted pose."""


class Registration(FrontEnd):
    """The neural tracker against the last keyframe (Sec. V)."""

    def __init__(self, tracker: Tracker, features: KeyframeFeatures, graph: KeyframeGraph, timer: StageTimer) -> None:
        self.tracker, self.features, self.graph, self.timer = tracker, features, graph, timer

    def track(self, view: Keyframe) -> Tracked:
        with self.timer.stage("track"):
            for reference in self.graph.tracking_references(view):
                result = self.tracker.track(self.features.of(view), self.features.of(reference))
                if result.status is not Status.LOST:
                    return Tracked(reference.T_wk @ torch.from_numpy(result.T_kc), result.status, Source.REGISTERED)
        return Tracked(view.T_wk, Status.LOST, Source.PREDICTED)


class AlignmentToMap(FrontEnd):
    """Alignment to the map from the predicted pose. If the result is doubtful, the registered pose and the last pose are tried too."""

    def __init__(
        self, aligner: MapAligner, registration: Registration, graph: KeyframeGraph, frames: FramePoses, timer: StageTimer
    ) -> None:
        self.aligner, self.registration, self.graph, self.frames, self.timer = aligner, registration, graph, frames, timer
        self.evidence = Evidence()  # evidence for the last frame's pose

    def state(self) -> State:
        """The evidence for the last pose."""
        return {"evidence": vars(self.evidence).copy()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.evidence = Evidence(**state["evidence"])

    def track(self, view: Keyframe) -> Tracked:
        aligned, registered = self._best_alignment(view)
        if aligned.status is not Status.LOST:
            return Tracked.aligned(aligned)
        evidence = replace(self.evidence, least_information=0.0)
        if registered is not None:
            return replace(registered, evidence=evidence, confident=False)  # the view does not match the map there
        return Tracked(view.T_wk, Status.LOST, Source.PREDICTED, evidence)

    def accept(self, view: Keyframe, tracked: Tracked) -> None:
        self.evidence = tracked.evidence
        if tracked.alignment is not None:
            self.aligner.accept(tracked.alignment, view.T_wk)

    def _best_alignment(self, view: Keyframe) -> tuple[Alignment, Tracked | None]:
        """The best alignment among the guesses, tried until one is not doubtful; and the registered pose if it was computed."""
        references = self.graph.references(self.aligner.config.references)
        best: Alignment | None = None
        registered: Tracked | None = None
        for guess, max_guess_error_px in self._guesses():
            T_guess = view.T_wk if guess is _Guess.PREDICTED else self._last_pose(view)
            if guess is _Guess.REGISTERED:
                answer = self.registration.track(view)
                if answer.is_lost:
                    continue
                registered, T_guess = answer, answer.T_wc
            with self.timer.stage("align"):
                aligned = self.aligner.align(view, T_guess, references, max_guess_error_px=max_guess_error_px)
            if best is None or aligned.score > _BETTER * best.score:
                best = aligned
            if not self.aligner.is_doubtful(best) and not self.aligner.unexpected(aligned, T_guess, max_guess_error_px):
                break
        assert best is not None
        return best, registered

    def _guesses(self) -> list[tuple[_Guess, float | None]]:
        """The guesses in order, each with a bound on its error [px]: the predicted pose with and without a bound, registered, last pose."""
        expected = self.aligner.expected
        nearby = [] if expected is None else [(_Guess.PREDICTED, expected)]
        return [*nearby, (_Guess.PREDICTED, None), (_Guess.REGISTERED, None), (_Guess.LAST, None)]

    def _last_pose(self, view: Keyframe) -> Tensor:
        return self.frames.T_wc(-1) if len(self.frames) else view.T_wk
