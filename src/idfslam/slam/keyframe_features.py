"""The tracker's features of keyframes, extracted once and kept with their images."""

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple, overload

from idfslam.graph.keyframe import Keyframe
from idfslam.tracking.frame_features import FrameFeatures
from idfslam.tracking.tracker import Tracker


class _Extraction(NamedTuple):
    """The features of a view, while they are extracted from its images in a thread of their own."""

    view: Keyframe
    images: FrameFeatures
    features: "Future[FrameFeatures]"


class KeyframeFeatures:
    """Extracts the features of a view on first use, and those of a keyframe beside the frames that follow it."""

    def __init__(self, tracker: Tracker) -> None:
        self.tracker = tracker
        self._pool = ThreadPoolExecutor(1, "features")
        self._running: _Extraction | None = None

    def images_of(self, view: Keyframe) -> FrameFeatures:
        """The images and points of a view; its features too if they were extracted."""
        if view.features is None:
            view.keep_features(self.tracker.images(view.frame))
        features: FrameFeatures = view.features
        return features

    def of(self, view: Keyframe) -> FrameFeatures:
        """The features of a view."""
        if self._running is not None and self._running.view is view:
            self._finish()
        images = self.images_of(view)
        if images.are_images_alone:
            view.keep_features(self.tracker.extract_features(images))
        features: FrameFeatures = view.features
        return features

    def extract_beside(self, keyframe: Keyframe) -> None:
        """Begins to extract the features of a keyframe in a thread of its own, where the tracker did not ask for them yet."""
        self._finish()
        if (images := self.images_of(keyframe)).are_images_alone:
            self._running = _Extraction(keyframe, images, self._pool.submit(self.tracker.extract_features, images))

    def _finish(self) -> None:
        """Keeps the features that were extracted beside the frames, if the view still has the images that they are of."""
        if self._running is not None:
            (view, images, features), self._running = self._running, None
            if view.features is images:
                view.keep_features(features.result())

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
