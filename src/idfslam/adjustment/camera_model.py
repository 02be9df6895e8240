"""What of a depth camera may be estimated: its lens, its sensor's centre, and its depth; projection with derivatives.

All values are deviations from the camera that is stated, so that zero means that it is right.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.sensing import depth_deformation
from idfslam.sensing.depth_deformation import DepthDeformation

Array = NDArray[np.float64]

# Standard deviations of a stated calibration's errors, where nothing else is known. Raised, a value counts as determined by weaker
# evidence, and is drawn less to what is stated. Sizes as between published and true calibrations of Kinects, some four times as wide
PRIORS = {
    "focal": 0.05,  # [1] of both focal lengths
    "aspect": 0.003,  # [1] of their ratio: pixels are square to a per mille
    "cx": 0.02,  # [1] of the image's width
    "cy": 0.02,  # [1] likewise
    "k1": 0.05,  # [1] distortion by the square of the radius, in OpenCV's model
    "k2": 0.05,  # [1] by its fourth power
    "depth_scale": 0.03,  # [1]
    "range": 0.02,  # [1] of DepthDeformation, and so on
    "across": 0.01,
    "along": 0.01,
    "across2": 0.01,
    "along2": 0.01,
}
NAMES = tuple(PRIORS)
"""The names of the values, in the order in which vectors have them."""
_LENS = slice(0, 6)
_DEPTH = slice(6, 12)


@dataclass(frozen=True)
class CameraModel:
    """A stated camera, and deviations `values` (P,) from it in the order of NAMES."""

    stated: Camera
    values: Array

    @staticmethod
    def as_stated(camera: Camera) -> "CameraModel":
        """The camera without deviations."""
        return CameraModel(camera, np.zeros(len(NAMES)))

    @property
    def camera(self) -> Camera:
        """The pinhole camera, without the distortion."""
        focal, aspect, cx, cy = self.values[:4].tolist()
        c = self.stated
        f = c.fx * (1 + focal), c.fy * (1 + focal) * (1 + aspect)
        return Camera(c.width, c.height, *f, c.cx + cx * c.width, c.cy + cy * c.width)

    @property
    def distortion(self) -> tuple[float, float]:
        """OpenCV's k1 and k2."""
        return float(self.values[4]), float(self.values[5])

    @property
    def depth_factor(self) -> float:
        """What readings are to be multiplied with, at 2 m on the average of the image, before the `deformation` is taken out."""
        scale, of_range = self.values[_DEPTH][:2].tolist()
        least = 1 + scale - of_range  # the factor f on readings z -> f z (1 + r (f z / 2 m - 1)) has f - f r = least and f^2 r = of_range
        return float((least + np.sqrt(least * least + 4 * of_range)) / 2)

    @property
    def deformation(self) -> DepthDeformation:
        """What depth needs beyond that factor."""
        f, (of_range, *over_image) = self.depth_factor, self.values[_DEPTH][1:].tolist()
        return DepthDeformation(of_range / f**2, *(value / f for value in over_image))

    def project(self, points: Array) -> tuple[Array, Array, Array]:
        """Pixels (N, 2) of points (N, 3) in the camera's frame, their derivatives by the points (N, 2, 3) and by the values (N, 2, P)."""
        c, (k1, k2) = self.camera, self.distortion
        z = points[:, 2]
        ray = points[:, :2] / z[:, None]
        r2 = (ray * ray).sum(1)
        stretch, slope = 1 + r2 * (k1 + r2 * k2), 2 * (k1 + 2 * k2 * r2)  # slope: by r2, times 2
        bent, f = ray * stretch[:, None], np.array([c.fx, c.fy])
        uv = bent * f + [c.cx, c.cy]
        by_ray = f[:, None] * (stretch[:, None, None] * np.eye(2) + slope[:, None, None] * ray[:, :, None] * ray[:, None])
        by_point = np.concatenate([by_ray / z[:, None, None], -(by_ray @ ray[:, :, None]) / z[:, None, None]], 2)
        by_values = np.zeros((len(points), 2, len(NAMES)))
        by_values[:, :, 0] = bent * f / (1 + self.values[0])
        by_values[:, 1, 1] = bent[:, 1] * c.fy / (1 + self.values[1])
        by_values[:, 0, 2] = by_values[:, 1, 3] = c.width
        by_values[:, :, 4], by_values[:, :, 5] = ray * f * r2[:, None], ray * f * (r2 * r2)[:, None]
        return uv, by_point, by_values

    def depth(self, uv: Array, readings: Array) -> tuple[Array, Array]:
        """The depths (N,) [m] that readings (N,) [m] at pixels (N, 2) stand for, and their derivatives by the values (N, P)."""
        by_values = np.zeros((len(uv), len(NAMES)))
        over = depth_deformation.terms(uv, readings, (self.stated.width, self.stated.height))
        by_values[:, _DEPTH] = readings[:, None] * np.concatenate([np.ones((len(uv), 1)), over], 1)
        return readings + by_values @ self.values, by_values

    def rays(self, uv: Array) -> Array:
        """The directions (N, 3) with z = 1 of pixels (N, 2): the inverse of `project`."""
        c, (k1, k2) = self.camera, self.distortion
        bent = (uv - [c.cx, c.cy]) / [c.fx, c.fy]
        ray = bent
        for _ in range(_INVERSIONS):
            r2 = (ray * ray).sum(1, keepdims=True)
            ray = bent / (1 + r2 * (k1 + r2 * k2))
        return np.concatenate([ray, np.ones((len(uv), 1))], 1)


_INVERSIONS = 8  # steps of the fixed-point iteration that takes distortion out; raised, strong distortion is inverted more exactly
