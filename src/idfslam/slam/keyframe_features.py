"""The tracker's features of keyframes, extracted once and kept with their images."""

from collections.abc import Sequence
from typing import overload

from idfslam.graph.keyframe import Keyframe
from idfslam.tracking.frame_features import FrameFeatures
from idfslam.tracking.tracker import Tracker


class KeyframeFeatures:
    """Extracts the features of a view on first use."""

    def __init__(self, tracker: Tracker) -> None:
        self.tracker = tracker

    def of(self, view: Keyframe) -> FrameFeatures:
        """The features of a view."""
        if view.features is None:
            view.keep_features(self.tracker.extract_features(view.frame))
        features: FrameFeatures = view.features
        return features

    def of_all(self, keyframes: Sequence[Keyframe]) -> Sequence[FrameFeatures]:
        """The features of keyframes, each extracted on first access."""
        return _LazyFeatures(self, keyframes)


class _LazyFeatures(Sequence[FrameFeatures]):
    def __init__(self, features: KeyframeFeatures, keyframes: Sequence[Keyframe]) -> None:
        self._features, self._keyframes = features, keyframes

    def __len__(self) -> int:
        return len(self._keyframes)

    @overload
    def __getitem__(self, i: int) -> FrameFeatures: ...

    @overload
    def __getitem__(self, i: slice) -> Sequence[FrameFeatures]: ...

    def __getitem__(self, i: int | slice) -> FrameFeatures | Sequence[FrameFeatures]:
        keyframes = self._keyframes[i]
        return self._features.of(keyframes) if isinstance(keyframes, Keyframe) else _LazyFeatures(self._features, keyframes)
