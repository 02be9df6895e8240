"""Relocalisation: a view's pose by a keyframe that looks similar, wherever the camera was thought to be.

The global descriptor says which keyframes to try, the neural tracker registers the view with each, and the alignment to map and images
there decides: a pose counts only if it explains what is seen, without doubt.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from idfslam.alignment.aligner import Aligner, Alignment
from idfslam.alignment.motion import change_between
from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.global_descriptor import codebook, global_descriptor
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.storage.frame_memory import FrameMemory
from idfslam.storage.state import State, Stateful
from idfslam.tracking.tracker import Tracker

_MIN_IN_VIEW = 0.3  # share of a keyframe's landmarks in view from which it can confirm a pose; more: fewer and safer confirmations
_SAME_PLACE = 0.5, math.radians(20)  # [m], [rad] within which two poses are one place; more: fewer answers count as ambiguous
_MAX_ERROR_RATIO = 1.3  # photometric error over the usual one up to which a relocalisation is accepted (right places: 0.8 to 1.3;
#                         doors that look alike: 1.5)
_RIVAL = 0.8  # share of the best score from which another place makes the answer ambiguous; more: fewer answers are refused


class Relocaliser(Stateful):
    """Finds views among keyframes."""

    def __init__(self, tracker: Tracker, features: KeyframeFeatures, aligner: Aligner, graph: KeyframeGraph) -> None:
        self.tracker, self.features, self.aligner, self.graph = tracker, features, aligner, graph
        self._codebook: Tensor | None = None
        self._descriptors: FrameMemory[Tensor] = FrameMemory()

    def state(self) -> State:
        """The codebook and the descriptors."""
        return {"codebook": self._codebook, "descriptors": self._descriptors.state()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._codebook = None if state["codebook"] is None else state["codebook"].to(self.tracker.device)
        self._descriptors.restore(state["descriptors"], lambda descriptor: descriptor.to(self.tracker.device))

    @property
    def references(self) -> int:
        """How many keyframes' images a view is compared with."""
        return self.aligner.config.references

    def descriptor(self, view: Keyframe) -> Tensor:
        """A view's global descriptor, computed once; the first view gives the codebook."""
        return self._descriptors.of(view, lambda: self._described(view))

    @torch.no_grad()
    def _described(self, view: Keyframe) -> Tensor:
        """From the features as they were trained: finetuned ones would make places seen earlier look different."""
        trunk = self.features.of(view).trunk[None]
        features = self.tracker.inference.head(trunk)[0].float()
        if self._codebook is None:
            self._codebook = codebook(features)
        return global_descriptor(features, self._codebook)

    def retrieve(self, view: Keyframe, keyframes: Sequence[Keyframe], count: int) -> list[int]:
        """Indices of the `count` keyframes whose descriptors are most similar to the view's."""
        if not keyframes:
            return []
        similarity = torch.stack([self.descriptor(k) for k in keyframes]) @ self.descriptor(view)
        return similarity.topk(min(count, len(keyframes))).indices.tolist()

    def registered(self, view: Keyframe, keyframe: Keyframe) -> Tensor | None:
        """The view's pose T_wc (4, 4) by the neural tracker against a keyframe; None if it is lost."""
        result = self.tracker.track(self.features.of(view), self.features.of(keyframe))
        return None if result.status is Status.LOST else keyframe.T_wk @ torch.from_numpy(result.T_kc)

    def verify_candidate(self, view: Keyframe, keyframe: Keyframe) -> Alignment | None:
        """The view's pose by a keyframe that looks similar, aligned to the map and the images there; None if in doubt."""
        T_guess = self.registered(view, keyframe)
        if T_guess is None:
            return None
        aligned = self.aligner.align(view, T_guess, self.graph.references_for(keyframe, self.references))
        return aligned if self.convincing(aligned) and self.aligner.fits(aligned, _MAX_ERROR_RATIO) else None

    def relocalise(self, view: Keyframe, keyframes: Sequence[Keyframe], tries: int) -> tuple[Keyframe, Alignment] | None:
        """The keyframe beside which a view is, of the `tries` most similar, and the view's pose; None if in doubt."""
        answers = []
        for i in self.retrieve(view, keyframes, tries):
            if aligned := self.verify_candidate(view, keyframes[i]):
                answers.append((keyframes[i], aligned))
        return unambiguous(answers)

    def verify_loop(self, view: Keyframe, keyframe: Keyframe) -> Tensor | None:
        """The view's pose T_wc (4, 4) by a keyframe from which it may have drifted away; None if in doubt.

        The images of the two alone decide where they agree: around them the map may hold both the surface and its drifted double.
        """
        T_wc = self.registered(view, keyframe)
        if T_wc is None or self.images_agree(view, keyframe, T_wc):
            return T_wc
        aligned = self.aligner.align(view, T_wc, self.graph.references_for(keyframe, self.references))
        return aligned.T_wc if self.convincing(aligned) else None

    def estimate_usual_error(self, keyframes: Sequence[Keyframe]) -> None:
        """Estimates the usual photometric error between stored keyframes; answers are judged by it while no frame was aligned yet."""
        errors = []
        for keyframe in keyframes:
            references = self.graph.older_references(keyframe, self.references)
            errors += [self.aligner.compare(keyframe, other, keyframe.T_wk)[1] for other in references]
            self.aligner.release(keyframe)
        self.aligner.expect(errors)

    def convincing(self, aligned: Alignment) -> bool:
        """Whether an alignment is unlikely to be an accident."""
        return aligned.status is Status.OK and aligned.in_view > _MIN_IN_VIEW and not self.aligner.doubtful(aligned)

    def images_agree(self, view: Keyframe, keyframe: Keyframe, T_wc: Tensor) -> bool:
        """Whether the view, at `T_wc` (4, 4), shows the keyframe's landmarks where they are."""
        in_view, error = self.aligner.compare(view, keyframe, T_wc)
        return in_view > _MIN_IN_VIEW and 0 < error <= self.aligner.doubtful_brightness


def unambiguous(answers: Sequence[tuple[Keyframe, Alignment]]) -> tuple[Keyframe, Alignment] | None:
    """The best of several answers to where a view is; None if there is none, or if another place explains it nearly as well."""
    if not answers:
        return None
    best = max(answers, key=lambda answer: answer[1].score)
    for _, other in answers:
        change = change_between(best[1].T_wc, other.T_wc)
        elsewhere = float(change[:3].norm()) > _SAME_PLACE[0] or float(change[3:].norm()) > _SAME_PLACE[1]
        if elsewhere and other.score > _RIVAL * best[1].score:
            return None
    return best
