"""What every live camera gives: images that come when they come."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera


@dataclass(frozen=True, eq=False)
class Capture:
    """A colour and a depth image of one moment, not yet made into a frame: what costs is done for those alone that are used."""

    timestamp: float  # [s], of the camera's own clock
    retrieve: Callable[[int], Frame]  # index -> frame; raises FrameError where the images cannot be used
    T_gt: NDArray[np.float64] | None = None  # (4, 4) true camera-to-world, where a recording is played


class DepthCamera(Protocol):
    """An opened camera. `grab` and `close` are called in one thread, `retrieve` of what was grabbed in another."""

    @property
    def name(self) -> str: ...

    @property
    def camera(self) -> Camera: ...

    def grab(self) -> Capture | None:
        """Waits for the next images; None where they end. Raises CameraError where the camera is gone."""

    def close(self) -> None: ...
