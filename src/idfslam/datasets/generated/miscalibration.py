"""A calibration that is a little off: the camera is not the stated one, and depth is scaled and warped."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.generated.sensor_noise import FARTHEST
from idfslam.geometry.camera import Camera

_FOCAL = 0.008, 0.012  # [1] error of the stated focal length, to either side. This and the rest, raised: a worse calibration. Sizes as
#    measured between published and true calibrations of Kinects
_ASPECT = 0.001  # [1] largest error of the ratio of the two focal lengths; raised, likewise
_CENTRE = 2.0, 4.5  # [px at a width of 640] error of each coordinate of the stated principal point; raised, likewise
_SCALE = 0.008, 0.012  # [1] error of depth; raised, likewise
_WARP = 0.006  # [1] error of depth that changes over the image and with depth; raised, likewise


@dataclass(frozen=True)
class Miscalibration:
    """The errors of a recording's calibration, all relative but the principal point's."""

    focal: tuple[float, float]  # [1] of fx, fy
    centre: tuple[float, float]  # [px at a width of 640] of cx, cy
    scale: float  # [1] of depth
    warp: float  # [1] of depth at its farthest in the corners; it is zero half-way

    @staticmethod
    def drawn(seed: int, strength: float) -> "Miscalibration":
        """The errors of a recording with this seed."""
        rng = np.random.default_rng([seed, 67])

        def error(low: float, high: float) -> float:
            return float(rng.uniform(low, high) * rng.choice([-1, 1]) * strength)

        focal, aspect = error(*_FOCAL), error(0, _ASPECT)
        centre = error(*_CENTRE), error(*_CENTRE)
        return Miscalibration((focal, focal + aspect), centre, error(*_SCALE), error(_WARP, _WARP))

    def stated(self, true: Camera) -> Camera:
        """The camera that the recording states, of which the images are not."""
        fx, fy = true.fx * (1 + self.focal[0]), true.fy * (1 + self.focal[1])
        cx, cy = (value + error * true.width / 640 for value, error in zip((true.cx, true.cy), self.centre))
        return Camera(true.width, true.height, fx, fy, cx, cy)

    def depth(self, z: NDArray[np.float32]) -> NDArray[np.float32]:
        """Depth (H, W) [m] as the sensor tells it; 0 stays 0. The warp grows from the middle of the image outwards, and with depth."""
        rows, columns = z.shape
        y, x = (np.arange(rows)[:, None] + 0.5) / rows * 2 - 1, (np.arange(columns) + 0.5) / columns * 2 - 1
        warp = self.warp * ((x * x + y * y) / 2 + z / FARTHEST - 1)
        return (z * (1 + self.scale + warp)).astype(np.float32)
