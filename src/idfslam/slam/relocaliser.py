"""Localisation: a view's pose by a keyframe that looks alike, wherever the camera was thought to be.

The place descriptor says which keyframes to try, the neural tracker registers the view with one of them, and the alignment to map and
images there has the last word: a pose counts only if it explains what is seen, without doubt.
"""

import math
from collections.abc import Sequence
from typing import overload

import torch
from torch import Tensor

from idfslam.alignment.aligner import Aligner, Alignment
from idfslam.alignment.motion import change_between
from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.global_descriptor import place_descriptor, vocabulary
from idfslam.storage.state import State
from idfslam.tracking.frame_features import Described
from idfslam.tracking.tracker import Tracker

_MIN_IN_VIEW = 0.3  # smaller share of a keyframe's landmarks in view: it cannot vouch for a place
_FAR_OFF = 0.5  # [m] beyond which two answers are two places
_AS_WELL = 1.3  # times the usual difference of brightness that a view found anywhere may have: places that look alike come to 1.5
_RIVAL = 0.8  # of the best answer's score, from which on another place makes it ambiguous


class Localiser:
    """Finds views among keyframes."""

    def __init__(self, tracker: Tracker, aligner: Aligner) -> None:
        self.tracker, self.aligner = tracker, aligner
        self._words: Tensor | None = None

    def state(self) -> State:
        """The visual words."""
        return {"words": self._words}

    def restore(self, state: State) -> None:
        """What `state` told."""
        self._words = None if state["words"] is None else state["words"].to(self.tracker.device)

    @property
    def references(self) -> int:
        """How many keyframes' images a view is held against."""
        return self.aligner.config.references

    def described(self, view: Keyframe) -> Described:
        """What the tracker keeps of a view, worked out once."""
        if view.described is None:
            view.described = self.tracker.describe(view.frame)
        return view.described

    @torch.no_grad()
    def place(self, view: Keyframe) -> Tensor:
        """A view's place descriptor, worked out once; the first view asked about gives the visual words.

        By the features as they came: finetuned ones would make places that were seen earlier look different.
        """
        if view.place is None:
            trunk = self.described(view).trunk[None]
            features = self.tracker.inference.head(trunk)[0].float()
            if self._words is None:
                self._words = vocabulary(features)
            view.place = place_descriptor(features, self._words)
        return view.place

    def most_alike(self, view: Keyframe, keyframes: Sequence[Keyframe], count: int) -> list[int]:
        """Indices of the `count` keyframes whose place looks most like the view's."""
        if not keyframes:
            return []
        likeness = torch.stack([self.place(k) for k in keyframes]) @ self.place(view)
        return likeness.topk(min(count, len(keyframes))).indices.tolist()

    def registered(self, view: Keyframe, keyframe: Keyframe) -> Tensor | None:
        """The view's pose T_wc (4, 4) by the neural tracker against a keyframe."""
        found = self.tracker.track(self.described(view), self.described(keyframe))
        return None if found.status is Status.LOST else keyframe.T_wk @ torch.from_numpy(found.T_kc)

    def locate(self, view: Keyframe, keyframe: Keyframe, references: Sequence[Keyframe]) -> Alignment | None:
        """The view's pose as it follows from a keyframe, held to the map there and to the images of `references`; None if in doubt."""
        T_guess = self.registered(view, keyframe)
        if T_guess is None:
            return None
        aligned = self.aligner.align(view, T_guess, references)
        return aligned if self.convincing(aligned) and self.aligner.fits(aligned, _AS_WELL) else None

    def locate_among(
        self, view: Keyframe, keyframes: Sequence[Keyframe], tries: int, graph: KeyframeGraph
    ) -> tuple[Keyframe, Alignment] | None:
        """The keyframe of a graph beside which a view is, of the `tries` that look most like it, and its pose; None if in doubt."""
        answers = []
        for i in self.most_alike(view, keyframes, tries):
            if found := self.locate(view, keyframes[i], graph.beside(keyframes[i], self.references)):
                answers.append((keyframes[i], found))
        return unambiguous(answers)

    def seen_again(self, view: Keyframe, keyframe: Keyframe, references: Sequence[Keyframe]) -> Tensor | None:
        """The view's pose T_wc (4, 4) beside a keyframe from which it may have drifted away; None if in doubt.

        The two alone decide where their images agree: around them the map may hold both the surface and its drifted double.
        """
        T_wc = self.registered(view, keyframe)
        if T_wc is None or self.agrees(view, keyframe, T_wc):
            return T_wc
        aligned = self.aligner.align(view, T_wc, references)
        return aligned.T_wc if self.convincing(aligned) else None

    def convincing(self, aligned: Alignment) -> bool:
        """Whether an alignment could not well be an accident."""
        return aligned.status is Status.OK and aligned.in_view > _MIN_IN_VIEW and not self.aligner.doubtful(aligned)

    def agrees(self, view: Keyframe, keyframe: Keyframe, T_wc: Tensor) -> bool:
        """Whether the view, at `T_wc` (4, 4), shows the keyframe's landmarks where they are."""
        seen, noise = self.aligner.compare(view, keyframe, T_wc)
        return seen > _MIN_IN_VIEW and 0 < noise <= self.aligner.doubtful_brightness


def unambiguous(answers: Sequence[tuple[Keyframe, Alignment]]) -> tuple[Keyframe, Alignment] | None:
    """The best of several answers (keyframe, alignment) to where a view is; None if there is none, or if two places serve alike."""
    if not answers:
        return None
    best = max(answers, key=lambda answer: answer[1].score)
    for _, other in answers:
        change = change_between(best[1].T_wc, other.T_wc)
        apart = float(change[:3].norm()) > _FAR_OFF or float(change[3:].norm()) > math.radians(20)
        if apart and other.score > _RIVAL * best[1].score:
            return None
    return best


class Descriptions(Sequence[Described]):
    """What the tracker keeps of keyframes, worked out for those that are asked for."""

    def __init__(self, localiser: Localiser, keyframes: Sequence[Keyframe]) -> None:
        self._localiser, self._keyframes = localiser, keyframes

    def __len__(self) -> int:
        return len(self._keyframes)

    @overload
    def __getitem__(self, i: int) -> Described: ...

    @overload
    def __getitem__(self, i: slice) -> Sequence[Described]: ...

    def __getitem__(self, i: int | slice) -> Described | Sequence[Described]:
        chosen = self._keyframes[i]
        return self._localiser.described(chosen) if isinstance(chosen, Keyframe) else Descriptions(self._localiser, chosen)
