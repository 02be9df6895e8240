"""The colour camera: an ideal one, and one with an exposure time, automatic exposure, vignetting and gamma."""

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.generated.exposure import AutomaticExposure, Exposure
from idfslam.datasets.generated.handheld_motion import HandheldMotion
from idfslam.datasets.generated.rendered import FPS
from idfslam.datasets.generated.sensor_noise import GRAIN
from idfslam.datasets.generated.shutter import row_times
from idfslam.geometry.camera import Camera
from idfslam.scenes.moving_scene import AnyScene

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_SAMPLE = 2.5  # [px] of motion between the moments that make up a blurred image; raised, it has fewer, seen as separate outlines
_SAMPLES = 6  # most such moments; raised, fast motion takes longer to render. This and the rest: chosen by hand
_NEAR = 1.5  # [m] distance for which the motion of the image is worked out; raised, it is underestimated near by
_VIGNETTE = 0.25, 0.45  # [1] light that is lost in the corners; raised, they are darker
_GAMMA = 1.8, 2.3  # [1] exponents of the film, 2 in the ideal twin; raised, shadows are brighter
_METER = 32, 24  # [px] size of the image whose brightness is measured; raised, the meter sees smaller lights


class ColourCamera:
    """A camera with an infinitely short exposure. `readout` is that of its shutter [s]."""

    def __init__(self, scene: AnyScene, camera: Camera, motion: HandheldMotion, readout: float) -> None:
        self.scene, self.camera, self.motion, self.readout = scene, camera, motion, readout

    def poses(self, timestamp: float) -> Array:
        """True poses (H, 4, 4) of the rows of an image; (1, 4, 4) of a global shutter."""
        return self.motion.pose_at(row_times(timestamp, self.readout, self.camera.height))

    def image(self, shot: int) -> Image:
        """(H, W, 3) image number `shot` without noise."""
        return self.scene.at(shot / FPS).render(self.camera, self.poses(shot / FPS)).colour

    def grain(self, shot: int) -> float:
        """[1] standard deviation of its noise."""
        return GRAIN


class AutomaticColourCamera(ColourCamera):
    """A camera that exposes by itself: light gathers while the camera moves, and the lens darkens the corners."""

    def __init__(self, scene: AnyScene, camera: Camera, motion: HandheldMotion, readout: float, seed: int, strength: float) -> None:
        super().__init__(scene, camera, motion, readout)
        rng = np.random.default_rng([seed, 73])
        self.vignette = _vignette(camera, min(float(rng.uniform(*_VIGNETTE)) * strength, 1.0))
        """(H, W) share of the light that reaches each pixel."""
        self.gamma = 2 * float(rng.uniform(*_GAMMA) / 2) ** strength
        self._automatic = AutomaticExposure(self._brightness, FPS, seed, strength)

    def exposure(self, shot: int) -> Exposure:
        """Time and gain of image number `shot`."""
        return self._automatic.of(shot)

    def moments(self, shot: int) -> Array:
        """(M,) [s] evenly spread over the exposure of an image's middle row, more where the image moves faster; their mean is its time."""
        stamp, time = shot / FPS, self.exposure(shot).time
        velocity = self.motion.velocity_at(stamp)
        blur = self.camera.fx * time * (np.linalg.norm(velocity[3:]) + np.linalg.norm(velocity[:3]) / _NEAR)
        count = int(np.clip(np.ceil(blur / _SAMPLE), 1, _SAMPLES))
        return stamp + time * ((np.arange(count) + 0.5) / count - 0.5)

    def image(self, shot: int) -> Image:
        """(H, W, 3) image number `shot` without noise: the mean of the light of its moments, developed."""
        moments = self.moments(shot)
        light = np.zeros((self.camera.height, self.camera.width, 3), np.float32)
        for moment in moments:
            light += radiance(self.scene.at(float(moment)).render(self.camera, self.poses(moment)).colour)
        light *= (self.vignette * (self.exposure(shot).brightness / len(moments)))[..., None].astype(np.float32)
        return developed(light, self.gamma)

    def grain(self, shot: int) -> float:
        """[1] standard deviation of its noise, which a gain amplifies."""
        return GRAIN * self.exposure(shot).gain

    def _brightness(self, shot: int) -> float:
        """What the meter sees: the mean logarithm of the light of a small image."""
        small = self.scene.at(shot / FPS).render(self.camera.resized(*_METER), self.motion.pose_at(np.array([shot / FPS])))
        return float(np.exp(np.log(np.maximum(radiance(small.colour).mean(-1), 1e-3)).mean()))


def radiance(colour: Image) -> Image:
    """Light of an image of a scene, (H, W, 3): the inverse of the film that scenes are rendered with, sqrt(1 - exp(-light))."""
    return -np.log1p(-np.minimum(colour * colour, np.float32(0.9999)))


def developed(light: Image, gamma: float) -> Image:
    """The image (H, W, 3) that light gives on such a film with the exponent 1 / gamma."""
    return np.power(-np.expm1(-light), np.float32(1 / gamma))


def _vignette(camera: Camera, corner: float) -> Array:
    """(H, W) from 1 in the middle to 1 - `corner` in the corners, with the square of the distance."""
    y, x = np.mgrid[: camera.height, : camera.width]
    square = ((x + 0.5) / camera.width * 2 - 1) ** 2 + ((y + 0.5) / camera.height * 2 - 1) ** 2
    return np.asarray(1 - corner * square / 2)
