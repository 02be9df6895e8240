"""A finished scene: shapes with baked light, rendered from any pose, and its true surface as triangles."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.scenes import lightmap
from idfslam.scenes.furniture import SceneBuilder
from idfslam.scenes.lightmap import Lightmap
from idfslam.scenes.ray_casting import BOX, ELLIPSOID, build_hierarchy, point_on
from idfslam.scenes.shading import Rendering, render, render_depth

Array = NDArray[np.float64]

KEPT = 8  # [1] finished rooms, and corridors, that stay in memory, at 2 and 5 MB each; raised, fewer are built twice. Chosen by hand
_CHORD = 4e-4  # [m] largest distance between a round surface and its triangles; raised, the true mesh has fewer triangles. Chosen by hand


@dataclass(frozen=True)
class BakedScene:
    """A scene in its own world frame: the origin is on the floor, z points up."""

    shapes: Array
    """(P, 17) as in `ray_casting`."""
    materials: Array
    """(M, 14) as in `procedural_textures`."""
    nodes: Array
    """(2 P - 1, 8) the bounding volumes of the shapes, as `build_hierarchy` returns them."""
    lightmap: Lightmap
    exposure: float
    """Scale from irradiance to the exposure of the film."""
    inner: Sequence[Sequence[int]]
    """The charts that face the inside, for each of the first shapes (floors, walls, ceilings)."""

    def at(self, seconds: float) -> "BakedScene":
        """The scene at a time: nothing in it moves."""
        return self

    def moving(self, camera: Camera, T_wc: Array, seconds: float) -> NDArray[np.bool_]:
        """(H, W) the pixels that show something that moves: none."""
        return np.zeros((camera.height, camera.width), np.bool_)

    def render(self, camera: Camera, T_wc: Array) -> Rendering:
        """Exact colour, depth and normals from a camera-to-world pose (4, 4), or from one for each row (H, 4, 4)."""
        return render(self.shapes, self.materials, self.nodes, self.lightmap, self.exposure, camera, T_wc)

    def render_depth(self, camera: Camera, T_wc: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Depth (H, W) and normals (H, W, 3) of `render` alone."""
        return render_depth(self.shapes, self.nodes, camera, T_wc)

    def surface(self) -> trimesh.Trimesh:
        """All surfaces except the outer sides of floors, walls and ceilings, as triangles; round ones to within 0.5 mm."""
        parts = []
        for p, shape in enumerate(self.shapes):
            charts = self.inner[p] if p < len(self.inner) else range(6 if shape[0] == BOX else 1 if shape[0] == ELLIPSOID else 3)
            parts += [_chart_mesh(self.shapes, p, chart) for chart in charts]
        vertices = np.concatenate([v for v, _ in parts])
        offsets = np.cumsum([0] + [len(v) for v, _ in parts[:-1]])
        faces = np.concatenate([f + offset for (_, f), offset in zip(parts, offsets)])
        return trimesh.Trimesh(vertices, faces, process=False)


def bake(scene: SceneBuilder, inner: Sequence[Sequence[int]]) -> BakedScene:
    """Bakes the light of a scene. The exposure gives the insides of floors, walls and ceilings a medium median brightness."""
    shapes, materials = np.array(scene.shapes), np.array(scene.materials)
    nodes = build_hierarchy(shapes)
    light = lightmap.bake(shapes, materials, nodes, np.array(scene.lights))
    brightness = light.light[: light.layout[len(inner), 0, 0]].mean(1)
    return BakedScene(shapes, materials, nodes, light, 1.0 / float(np.median(brightness[brightness > 0])), inner)


def _chart_mesh(shapes: Array, p: int, chart: int) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) [m] and faces (F, 3), oriented outwards, of one chart."""
    shape = shapes[p]
    kind = int(shape[0])
    radius = max(shape[1:3].max(), shape[3] if kind == ELLIPSOID else 0)
    segments = max(12, int(np.ceil(np.pi / np.arccos(1 - min(_CHORD / radius, 0.5)))))
    if kind != BOX and kind != ELLIPSOID and chart > 0:
        ring = np.linspace(0, 2 * np.pi, segments, endpoint=False)
        st = np.stack([np.cos(ring), np.sin(ring)], 1) / 2 + 0.5
        faces = np.array([[0, i, i + 1] for i in range(1, segments - 1)])
        faces = faces if chart == 2 else faces[:, ::-1]
    else:
        columns, rows = (1, 1) if kind == BOX else (segments, (segments + 1) // 2 if kind == ELLIPSOID else 1)
        t, s = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
        st = np.stack([s.ravel(), t.ravel()], 1)
        i, j = np.meshgrid(np.arange(columns), np.arange(rows))
        corner = (j * (columns + 1) + i).ravel()
        up = corner + columns + 1
        faces = np.concatenate([np.stack([corner, corner + 1, up], 1), np.stack([corner + 1, up + 1, up], 1)])
        if kind == BOX and chart in (0, 3, 4):  # the normal s x t points inwards on these
            faces = faces[:, ::-1]
    return np.array([point_on(shapes, p, chart, s, t) for s, t in st]), faces
