"""The interface of all live cameras."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera


@dataclass(frozen=True, eq=False)
class Capture:
    """A colour image and its depth image, not yet converted: the conversion is costly and done only for images that are used."""

    timestamp: float  # [s] of colour, by the camera's own clock
    retrieve: Callable[[int], Frame]  # frame index -> frame; raises FrameError if the images cannot be used
    T_gt: NDArray[np.float64] | None = None  # (4, 4) true camera-to-world pose; only a replayed recording has it


class DepthCamera(Protocol):
    """An opened camera. `grab` and `close` are called by one thread, `Capture.retrieve` by another.

    An attribute `timing`, a SensorTiming, says what is known about the sensor's times, as its frames do.
    """

    @property
    def name(self) -> str: ...

    @property
    def camera(self) -> Camera: ...

    def grab(self) -> Capture | None:
        """Waits for the next images; None after the last ones. Raises CameraError if the camera was disconnected."""

    def close(self) -> None: ...
