"""A walking figure: torso, hips, head, and arms and legs of two segments that swing with its steps, in textured clothes."""

import numpy as np
from numpy.typing import NDArray

from idfslam.scenes import furniture
from idfslam.scenes import procedural_textures as pattern
from idfslam.scenes.floor_path import FloorPath
from idfslam.scenes.furniture import SceneBuilder, place, tilt
from idfslam.scenes.ray_casting import FRUSTUM

Array = NDArray[np.float64]

# Proportions of a figure, shares of its height. All of them and the gait: chosen by hand
_HIP, _SHOULDER, _HEAD = 0.52, 0.82, 0.925  # heights of the joints and of the head's middle; raised, they are higher
_THIGH, _SHIN = 0.25, 0.235  # lengths of a leg's segments; longer: longer legs
_UPPER_ARM, _FOREARM = 0.17, 0.16  # lengths of an arm's segments; longer: longer arms
_STRIDE = 1.35  # [m] of two steps; longer: fewer steps
_SWING = np.deg2rad(28), np.deg2rad(24)  # [rad] of legs and arms at a usual pace; more: longer steps
_KNEE, _ELBOW = np.deg2rad(48), np.deg2rad(30)  # [rad] largest bend of a swinging leg, and bend of an arm; more: more bent
_PACE = 1.0  # [m/s] from which arms and legs swing fully; raised, slow steps are shorter


class WalkingFigure:
    """A figure of a height [m] that walks along a path. Its colours and patterns are drawn from the random numbers of `materials`."""

    def __init__(self, materials: SceneBuilder, path: FloorPath, height: float) -> None:
        rng = materials.rng
        self.path, self.height, self._phase = path, height, float(rng.uniform(0, 2 * np.pi))
        shirts = pattern.STRIPES, pattern.WALLPAPER, pattern.BRICKS, pattern.TILES
        colours = furniture.vivid(rng, 0.15, 0.55), furniture.vivid(rng, 0.1, 0.4), (0.7, 0.66, 0.58)
        self._shirt = materials.material(int(rng.choice(shirts)), *colours, scale=float(rng.uniform(0.05, 0.11)))
        trousers = furniture.vivid(rng, 0.08, 0.3)
        self._trousers = materials.material(pattern.FABRIC, furniture.darker(trousers, 0.6), furniture.darker(trousers, 1.4))
        self._skin = materials.material(pattern.PAINT, furniture.darker((0.62, 0.44, 0.34), float(rng.uniform(0.4, 1.1))), contrast=0.3)
        self._hair = materials.material(pattern.WOOD, furniture.darker((0.2, 0.12, 0.07), float(rng.uniform(0.4, 2))), (0.05, 0.03, 0.02))

    def draw(self, scene: SceneBuilder, seconds: float) -> None:
        """Draws the figure at a time."""
        h, path = self.height, self.path
        x, y = path.place(seconds)
        phase = 2 * np.pi * path.distance(seconds) / _STRIDE + self._phase
        swing = min(path.speed(seconds) / _PACE, 1.0)
        body = place(x, y, 0.012 * h * swing * np.cos(2 * phase), turn=float(np.rad2deg(path.heading(seconds))))
        scene.ball(body, (0, 0, (_HIP + _SHOULDER) / 2 * h), (0.075 * h, 0.115 * h, 0.195 * h), self._shirt)
        scene.ball(body, (0, 0, _HIP * h), (0.07 * h, 0.1 * h, 0.075 * h), self._trousers)
        scene.tube(body, (0, 0, _SHOULDER * h), 0.06 * h, (0.032 * h, 0.03 * h), self._skin)
        scene.ball(body, (0.01 * h, 0, _HEAD * h), (0.055 * h, 0.045 * h, 0.072 * h), self._skin)
        scene.ball(body, (-0.006 * h, 0, (_HEAD + 0.016) * h), (0.055 * h, 0.049 * h, 0.066 * h), self._hair)
        for side, own in ((1, phase), (-1, phase + np.pi)):
            self._leg(scene, body, side, own, swing)
            self._arm(scene, body, side, own + np.pi, swing)

    def _leg(self, scene: SceneBuilder, body: Array, side: int, phase: float, swing: float) -> None:
        h = self.height
        hip = body @ place(0, side * 0.052 * h, _HIP * h) @ _pitched(_SWING[0] * swing * np.sin(phase))
        knee = _segment(scene, hip, _THIGH * h, (0.05 * h, 0.036 * h), self._trousers)
        ankle = knee @ _pitched(-_KNEE * swing * max(np.cos(phase), 0.0))
        foot = _segment(scene, ankle, _SHIN * h, (0.036 * h, 0.026 * h), self._trousers)
        scene.box(foot, (-0.03 * h, -0.026 * h, -0.03 * h), (0.11 * h, 0.026 * h, 0.01 * h), self._hair)

    def _arm(self, scene: SceneBuilder, body: Array, side: int, phase: float, swing: float) -> None:
        h = self.height
        shoulder = body @ place(0, side * 0.125 * h, (_SHOULDER - 0.02) * h) @ _pitched(_SWING[1] * swing * np.sin(phase))
        elbow = _segment(scene, shoulder, _UPPER_ARM * h, (0.032 * h, 0.026 * h), self._shirt)
        hand = _segment(scene, elbow @ _pitched(_ELBOW), _FOREARM * h, (0.026 * h, 0.02 * h), self._skin)
        scene.ball(hand, (0, 0, -0.02 * h), (0.024 * h, 0.016 * h, 0.035 * h), self._skin)


def _pitched(angle: float) -> Array:
    """(4, 4) a joint bent forwards by an angle [rad]."""
    return tilt(1, float(-np.rad2deg(angle)))


def _segment(scene: SceneBuilder, joint: Array, length: float, radii: tuple[float, float], material: int) -> Array:
    """Draws a segment that hangs from a joint (4, 4), with a round joint at its top; returns the joint at its end (4, 4)."""
    scene.ball(joint, (0, 0, 0), (radii[0],) * 3, material)
    scene.add(FRUSTUM, joint, (0, 0, -length / 2), (radii[1], radii[0], length / 2), material)
    return joint @ place(0, 0, -length)
