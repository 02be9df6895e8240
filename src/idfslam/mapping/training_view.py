"""The views that the map learns from: snapshots of frames with poses."""

from collections.abc import Callable, Hashable
from functools import cached_property
from typing import Any, Protocol

from torch import Tensor

from idfslam.geometry.camera import Camera
from idfslam.sensing.light import Light


class FrameImages(Hashable, Protocol):
    """The images of a frame. It is the same object as long as they are in memory."""

    @property
    def depth(self) -> Tensor: ...  # (H, W) [m], 0 = no reading

    @property
    def colour(self) -> Tensor: ...  # (H, W, 3) in [0, 1]


class PosedFrame(Protocol):
    """A frame with a pose, such as a keyframe of the graph."""

    T_wk: Tensor  # (4, 4) float64

    @property
    def index(self) -> int: ...

    @property
    def camera(self) -> Camera: ...

    @property
    def images(self) -> Any: ...  # FrameImages

    @property
    def farthest(self) -> float: ...  # [m]


class TrainingView:
    """A snapshot of a frame. While the map learns in the background, its pose does not move, and its images stay in memory."""

    def __init__(self, frame: PosedFrame, light: Callable[[], Light | None] = lambda: None) -> None:
        """light: tells how the frame shows the scene's colours, which the map learns. None: as they are."""
        self._light = light
        self.frame, self.index, self.T_wk, self.camera = frame, frame.index, frame.T_wk, frame.camera
        self.images: FrameImages = frame.images

    @cached_property
    def light(self) -> Light | None:
        """How the frame shows the scene's colours. It is worked out where the map learns."""
        return self._light()

    @property
    def depth(self) -> Tensor:
        """(H, W) [m], 0 = no reading."""
        return self.images.depth

    @property
    def colour(self) -> Tensor:
        """(H, W, 3) in [0, 1]."""
        return self.images.colour
