"""Relocalisation: a view's pose from keyframes that look similar, without a prediction.

The global descriptor selects keyframes, and the neural tracker registers the view with each. The view is then aligned to the map and to the
images there. Only an alignment without doubt is accepted.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from idfslam.alignment.aligner import MapAligner
from idfslam.alignment.alignment import TELLING_SHARE, Alignment
from idfslam.alignment.motion import change_between
from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.front_end.pair_registration import PairRegistration
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.slam.place_recognition.global_descriptor import codebook, global_descriptor
from idfslam.storage.frame_memory import FrameMemory
from idfslam.storage.state import State, Stateful
from idfslam.tracking.tracker import Tracker

# All of these were chosen by hand.
_SAME_PLACE = 0.5, math.radians(20)  # [m], [rad] largest difference of two poses at one place. More: fewer results are ambiguous
# [1] Largest ratio of the photometric error to the usual one of an accepted relocalisation (right places: 0.8 to 1.3; doors that look
# alike: 1.5). More: more relocalisations, and more wrong ones.
_MAX_ERROR_RATIO = 1.3
_RIVAL = 0.8  # [1] share of the best score above which another place makes the result ambiguous. More: fewer results are refused


class Relocaliser(Stateful):
    """Finds views among keyframes."""

    def __init__(self, tracker: Tracker, features: KeyframeFeatures, aligner: MapAligner, graph: KeyframeGraph, *, references: int) -> None:
        """references: number of keyframes whose images a view is compared with."""
        self.references = references
        self.tracker, self.features, self.aligner, self.graph = tracker, features, aligner, graph
        self.pairs = PairRegistration(tracker, features)
        self._codebook: Tensor | None = None
        self._descriptors: FrameMemory[Tensor] = FrameMemory()

    def state(self) -> State:
        """The codebook and the descriptors."""
        return {"codebook": self._codebook, "descriptors": self._descriptors.state()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._codebook = None if state["codebook"] is None else state["codebook"].to(self.tracker.device)
        self._descriptors.restore(state["descriptors"], lambda descriptor: descriptor.to(self.tracker.device))

    def descriptor(self, view: Keyframe) -> Tensor:
        """A view's global descriptor, computed once; the first view gives the codebook."""
        return self._descriptors.of(view, lambda: self._compute_descriptor(view))

    @torch.no_grad()
    def _compute_descriptor(self, view: Keyframe) -> Tensor:
        """The descriptor from the features before finetuning. Finetuned ones would change the descriptors of places seen earlier."""
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

    def registered(self, view: Keyframe, keyframe: Keyframe, near: Tensor | None = None) -> Tensor | None:
        """Registers a view against a keyframe by the neural tracker: its pose T_wc (4, 4), or None if it is lost.

        near: a pose (4, 4) that it probably has.
        """
        found = self.pairs.register(view, keyframe, near)
        return None if found is None else found.T_wc

    def verify_candidate(self, view: Keyframe, keyframe: Keyframe) -> Alignment | None:
        """Registers a view against a candidate keyframe, then aligns it to the map and the images there; None if the result is doubtful."""
        T_guess = self.registered(view, keyframe)
        if T_guess is None:
            return None
        aligned = self.aligner.align(view, T_guess, self.graph.references_for(keyframe, self.references))
        alike = self.aligner.usual_error.is_within(aligned.photometric_error, _MAX_ERROR_RATIO)
        return aligned if alike and self.convincing(aligned) else None

    def relocalise(self, view: Keyframe, keyframes: Sequence[Keyframe], tries: int) -> tuple[Keyframe, Alignment] | None:
        """Relocalises a view: the best of the `tries` most similar keyframes, and the view's alignment; None if there is doubt."""
        results = []
        for i in self.retrieve(view, keyframes, tries):
            if aligned := self.verify_candidate(view, keyframes[i]):
                results.append((keyframes[i], aligned))
        return unambiguous(results)

    def verify_loop(self, view: Keyframe, keyframe: Keyframe) -> Tensor | None:
        """The pose T_wc (4, 4) of a view from a keyframe from which it may have drifted; None if there is doubt.

        If the images of the two agree, the registered pose is taken without the map: the map may have the surface twice there, once with
        drift.
        """
        T_wc = self.registered(view, keyframe)
        if T_wc is None or self.images_agree(view, keyframe, T_wc):
            return T_wc
        aligned = self.aligner.align(view, T_wc, self.graph.references_for(keyframe, self.references))
        return aligned.T_wc if self.convincing(aligned) else None

    def estimate_usual_error(self, keyframes: Sequence[Keyframe]) -> None:
        """Estimates the usual photometric error from stored keyframes, by which results are judged before a frame was aligned."""
        errors, displacements = [], []
        for keyframe in keyframes:
            references = self.graph.older_references(keyframe, self.references)
            errors += [self.aligner.photometric_comparison(keyframe, other, keyframe.T_wk)[1] for other in references]
            displacements.append(self.aligner.displacement(keyframe, keyframe.T_wk, references))
            self.aligner.appearances.release(keyframe)
        self.aligner.usual_error.expect(errors)
        self.aligner.doubt.expect(displacements)

    def convincing(self, aligned: Alignment) -> bool:
        """Whether an alignment is unlikely to be accidental: it is not doubtful, sees enough landmarks, and they are as bright as usual."""
        surely = aligned.status is Status.OK and aligned.in_view > TELLING_SHARE and not self.aligner.is_doubtful(aligned)
        return surely and aligned.photometric_error <= self.aligner.usual_error.doubtful

    def images_agree(self, view: Keyframe, keyframe: Keyframe, T_wc: Tensor) -> bool:
        """Whether a view at `T_wc` (4, 4) sees enough of a keyframe's landmarks, with a small photometric error."""
        in_view, error = self.aligner.photometric_comparison(view, keyframe, T_wc)
        return in_view > TELLING_SHARE and 0 < error <= self.aligner.usual_error.doubtful


def unambiguous(results: Sequence[tuple[Keyframe, Alignment]]) -> tuple[Keyframe, Alignment] | None:
    """The result with the best score; None if there is none, or if one at another place scores nearly as well."""
    if not results:
        return None
    best = max(results, key=lambda result: result[1].score)
    for _, other in results:
        change = change_between(best[1].T_wc, other.T_wc)
        elsewhere = float(change[:3].norm()) > _SAME_PLACE[0] or float(change[3:].norm()) > _SAME_PLACE[1]
        if elsewhere and other.score > _RIVAL * best[1].score:
            return None
    return best
