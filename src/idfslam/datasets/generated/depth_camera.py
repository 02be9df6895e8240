"""The depth camera: one with the noise of a Kinect, and one that also has larger holes, and readings in mid-air at edges."""

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from idfslam.datasets.generated.sensor_noise import BASELINE_FOCAL, noisy_depth
from idfslam.geometry.camera import Camera
from idfslam.scenes.moving_scene import AnyScene

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_EDGE = 0.03  # [1] relative depth step within 3 x 3 pixels across which readings are mixed; raised, fewer are. This and the rest: by hand
_FLYING = 0.5  # [1] share of the readings at such edges that fly; raised, more do
_DARK = 0.14, 0.42  # [1] brightness below which all readings are lost, and above which none are; raised, holes are larger
_GRAZING = np.cos(np.deg2rad(80)), np.cos(np.deg2rad(58))  # cosines of the angle to the normal, likewise
_LOST = 0.85  # [1] share lost of the darkest and most slanted surfaces; raised, holes are larger
_PATCH = 12  # [px at a width of 640] size of the patches that are lost together; raised, holes are fewer and larger
_SMALLER = 4  # how many times smaller the image is in which dark surfaces are found; raised, small ones are missed


class SimulatedDepthCamera:
    """A structured-light camera (Kinect) with the noise of `sensor_noise`."""

    def __init__(self, scene: AnyScene, camera: Camera) -> None:
        self.scene, self.camera = scene, camera

    def image(self, poses: Array, seconds: float, rng: Generator, faults: Generator) -> Image:
        """(H, W) depth [m], 0: no reading, from `poses` (4, 4) or one for each row (H, 4, 4), at a time.

        `rng` draws the noise, `faults` the rest.
        """
        depth, normals = self.scene.at(seconds).render_depth(self.camera, poses)
        return noisy_depth(depth, normals, self.camera, rng)


class ImperfectDepthCamera(SimulatedDepthCamera):
    """Such a camera with shadows of its projector, holes in dark and slanted surfaces, and flying pixels."""

    def __init__(self, scene: AnyScene, camera: Camera, strength: float) -> None:
        super().__init__(scene, camera)
        self._strength = strength

    def image(self, poses: Array, seconds: float, rng: Generator, faults: Generator) -> Image:
        """Depth as of `DepthCamera`, with these faults."""
        exact, normals = self.scene.at(seconds).render_depth(self.camera, poses)
        lost = projector_shadow(exact, self._strength * self.camera.width / 640)
        lost |= patches(exact.shape, self.camera.width, faults) < self._strength * self._weakness(normals, poses, seconds)
        depth = noisy_depth(with_flying_pixels(exact, self._strength, faults), normals, self.camera, rng)
        return np.where(lost, np.float32(0), depth)

    def _weakness(self, normals: Image, poses: Array, seconds: float) -> Array:
        """(H, W) probability that a reading is lost since its surface is dark or slanted."""
        rows, columns = normals.shape[:2]
        small = self.camera.resized(max(columns // _SMALLER, 1), max(rows // _SMALLER, 1))
        seen = poses if len(poses) == 1 else poses[((np.arange(small.height) + 0.5) * rows / small.height).astype(int)]
        bright = cv2.resize(self.scene.at(seconds).render(small, seen).colour.mean(-1), (columns, rows), interpolation=cv2.INTER_LINEAR)
        x = (np.arange(columns) - self.camera.cx) / self.camera.fx
        y = (np.arange(rows)[:, None] - self.camera.cy) / self.camera.fy
        cosine = np.abs(normals[..., 0] * x + normals[..., 1] * y + normals[..., 2]) / np.sqrt(x * x + y * y + 1)
        return np.asarray(_LOST * np.maximum(_below(bright, _DARK), _below(cosine, _GRAZING)))


def projector_shadow(depth: Image, scale: float) -> NDArray[np.bool_]:
    """(H, W) where the projector, beside the camera, does not reach a surface (H, W) [m] past a nearer one to its right.

    The pixel at u with disparity d is dark if one at u' > u has a disparity above d + u' - u by more than a pixel. `scale` multiplies the
    disparities [px].
    """
    shift = scale * BASELINE_FOCAL / np.maximum(depth, 0.1) - np.arange(depth.shape[1])
    highest = np.maximum.accumulate(shift[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(highest > shift + 1)


def with_flying_pixels(depth: Image, strength: float, rng: Generator) -> Image:
    """Depth (H, W) [m] in which readings at edges are mixed from the nearer and the farther surface."""
    kernel = np.ones((3, 3), np.uint8)
    near, far = cv2.erode(depth, kernel), cv2.dilate(depth, kernel)
    flying = (rng.random(depth.shape) < _FLYING * strength) & (far - near > _EDGE * near) & (near > 0)
    share = rng.random(depth.shape, dtype=np.float32)
    return np.where(flying, near + share * (far - near), depth).astype(np.float32)


def patches(shape: tuple[int, int], width: int, rng: Generator) -> Array:
    """(H, W) random numbers, evenly spread between 0 and 1, that are alike in patches."""
    sigma = _PATCH * width / 640 / 2
    noise = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(1 / (1 + np.exp(-1.702 * noise / noise.std())))  # the normal distribution function, to one hundredth


def _below(value: NDArray[np.floating], limits: tuple[float, float]) -> NDArray[np.floating]:
    """From 1 at the lower limit to 0 at the upper one."""
    return np.clip((limits[1] - value) / (limits[1] - limits[0]), 0, 1)
