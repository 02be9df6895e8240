"""What moved, in hindsight: at the end of a run, what its stored views show of things that did not stay is hidden in them.

While the camera moves, a view is segmented by the views before it, and a keyframe also by the few after it. At the end all are known. Where
nothing was found to move by then, the views stay as they are.
"""

from abc import ABC, abstractmethod

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.geometry.depth_view import DepthView
from idfslam.graph.coverage import Coverage
from idfslam.graph.frame_poses import FramePoses
from idfslam.segmentation.coarse_view import coarse_view
from idfslam.segmentation.occupancy_history import OccupancyHistory, StoredView
from idfslam.slam.motion_segmentation.motion_segmentation import FreeSpaceSegmentation
from idfslam.slam.stage_timer import StageTimer
from idfslam.views.encoded_view import decode_depth
from idfslam.views.view_selection import ViewSelection

Mask = NDArray[np.bool_]


class Hindsight(ABC):
    """Hides what moved in the stored views."""

    @abstractmethod
    def run(self) -> None:
        """Called once, after the last frame, before keyframes and map are polished."""


class NoHindsight(Hindsight):
    """The views stay as they are."""

    def run(self) -> None: ...


class FreeSpaceHindsight(Hindsight):
    """Hides it in the mapped views, keyframes among them, and in the archive's images."""

    def __init__(
        self, segmentation: FreeSpaceSegmentation, frames: FramePoses, coverage: Coverage, views: ViewSelection, timer: StageTimer
    ) -> None:
        self.segmentation, self.frames, self.coverage, self.views, self.timer = segmentation, frames, coverage, views, timer

    def run(self) -> None:
        if not self.segmentation.found:
            return
        with self.timer.stage("segment"):
            depths, mapped = [packed.view(T_wc) for T_wc, packed in self.coverage.unmasked()], self.coverage.indices()
            views, images = [_stored(*view) for view in zip(depths, mapped)], self._images()
            history = OccupancyHistory.of([*views, *(image for image in images.values() if image.number not in set(mapped))])
            moving = [history.moving(view) for view in views]
            self.coverage.hide([_resized(cells, depth.camera) for cells, depth in zip(moving, depths)])
            self._hide_in_keyframes(dict(zip(mapped, moving)))
            for i, image in images.items():
                if (cells := history.moving(image)).any():
                    self.views.hide(i, cells)

    def _images(self) -> dict[int, StoredView]:
        """The archive's images by their numbers in it; a cell for each pixel of depth or for some."""
        camera, main, found = self.views.camera, self.frames.graph.main_submap, dict[int, StoredView]()
        for i, view in enumerate(self.views.views):
            depth = decode_depth(view.depth)
            if camera is not None and depth is not None and self.frames.submap(view.index) == main:
                small = camera.every(camera.height // depth.shape[0])
                found[i] = _stored(DepthView(self.frames.T_wc(view.index).numpy(), np.maximum(depth, 0), small), view.index)
        return found

    def _hide_in_keyframes(self, moving: dict[int, Mask]) -> None:
        """moving: the cells of mapped views, by the indices of their frames."""
        main = self.frames.graph.main_submap
        for keyframe in self.frames.graph.keyframes:
            if keyframe.submap == main and keyframe.index in moving and moving[keyframe.index].any():
                self.segmentation.hide(keyframe, _resized(moving[keyframe.index], keyframe.camera))


def _stored(depth: DepthView, index: int) -> StoredView:
    """A depth image in cells, without colour."""
    black = np.zeros((*depth.depth.shape, 3), np.float32)
    return StoredView(coarse_view(np.ascontiguousarray(depth.depth), black, depth.camera), depth.T_wc, index)


def _resized(cells: Mask, camera: Camera) -> Mask:
    """(H, W) cells (h, w) in the pixels of a camera."""
    return np.asarray(cv2.resize(cells.astype(np.uint8), (camera.width, camera.height), interpolation=cv2.INTER_NEAREST) > 0)
