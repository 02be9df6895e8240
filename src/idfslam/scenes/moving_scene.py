"""A finished scene in which bodies move: at each time it is a scene of its own, rendered as any other.

The bodies cast no shadow, and their light is that of a room lit from above, so the light of the static scene stays as it was baked.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Protocol

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.scenes import lightmap
from idfslam.scenes.baked_scene import BakedScene
from idfslam.scenes.furniture import SceneBuilder
from idfslam.scenes.lightmap import Lightmap
from idfslam.scenes.ray_casting import build_hierarchy

Array = NDArray[np.float64]

_BRIGHTNESS = 1.0  # [1] light on a body, relative to the median of walls, floor and ceiling; raised, bodies are brighter. Chosen by hand
_FROM_ABOVE = 0.25  # [1] by how much of it the top is brighter than the sides; raised, round shapes show more. Chosen by hand
_KEPT = 4  # scenes of the last times; raised, more threads render at once without making one twice


class Body(Protocol):
    """Something that moves: it draws its shapes into a scene, always the same ones in the same order, where they are at a time."""

    def draw(self, scene: SceneBuilder, seconds: float) -> None: ...


class MovingScene:
    """A static scene and bodies that move in it. `at(seconds)` is the whole, `bodies_at(seconds)` the bodies alone."""

    def __init__(self, static: BakedScene, bodies: Sequence[Body], materials: Sequence[Array]) -> None:
        """materials: those that the bodies' shapes name by their numbers, as in `furniture.SceneBuilder`."""
        self.static, self.bodies, self._materials = static, bodies, np.array(materials)
        self._light = _light(self._shapes(0.0), static.exposure)
        self.bodies_at = lru_cache(_KEPT)(self._bodies_at)
        """The bodies alone at a time [s], as a scene."""
        self.at = lru_cache(_KEPT)(self._at)
        """The static scene with the bodies where they are at a time [s]."""

    def moving(self, camera: Camera, T_wc: Array, seconds: float) -> NDArray[np.bool_]:
        """(H, W) the pixels that show a body, from a pose (4, 4), or from one for each row (H, 4, 4)."""
        seen, bodies = (scene.render_depth(camera, T_wc)[0] for scene in (self.at(seconds), self.bodies_at(seconds)))
        return np.asarray((bodies > 0) & (bodies <= seen))

    def surface(self) -> trimesh.Trimesh:
        """The surface of the static scene."""
        return self.static.surface()

    def _shapes(self, seconds: float) -> Array:
        """(P, 17) of all bodies."""
        scene = SceneBuilder(np.random.default_rng(0))
        for body in self.bodies:
            body.draw(scene, seconds)
        return np.array(scene.shapes)

    def _bodies_at(self, seconds: float) -> BakedScene:
        shapes = self._shapes(seconds)
        return BakedScene(shapes, self._materials, build_hierarchy(shapes), self._light, self.static.exposure, ())

    def _at(self, seconds: float) -> BakedScene:
        return joined(self.static, self.bodies_at(seconds))


AnyScene = BakedScene | MovingScene


def joined(a: BakedScene, b: BakedScene) -> BakedScene:
    """Two scenes as one, with the exposure of the first. Rays search one hierarchy after the other."""
    shapes, nodes, layout = b.shapes.copy(), b.nodes.copy(), b.lightmap.layout.copy()
    shapes[:, 16] += len(a.materials)
    nodes[:, 6] += len(a.nodes)
    nodes[nodes[:, 7] >= 0, 7] += len(a.shapes)
    layout[..., 0] += len(a.lightmap.light)
    light = Lightmap(np.concatenate([a.lightmap.layout, layout]), np.concatenate([a.lightmap.light, b.lightmap.light]))
    both = np.concatenate
    parts = both([a.shapes, shapes]), both([a.materials, b.materials]), both([a.nodes, nodes])
    return BakedScene(*parts, light, a.exposure, a.inner)


def _light(shapes: Array, exposure: float) -> Lightmap:
    """Light from above on shapes (P, 17) as they stand: what turns later keeps its light."""
    layout = lightmap.layout_of(shapes)
    up = lightmap.normals(shapes, layout)[:, 2:]
    light = _BRIGHTNESS / exposure * (1 + _FROM_ABOVE * up)
    return Lightmap(layout, np.tile(light, (1, 3)).astype(np.float32))
