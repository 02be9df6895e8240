"""Pictures of a mesh with vertex colours, by ray casting: from a camera's pose, and from above into the room."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from idfslam.errors import ResultError
from idfslam.geometry.camera import Camera
from idfslam.geometry.ray_casting import RayCaster, pixel_rays

Floats = NDArray[np.floating]
_MAX_BACK_FACES = 12  # a ray passes through so many back faces at most; more: slower, fewer holes where many surfaces overlap
_STEP = 1e-4  # [m] from a back face to the next start of its ray; larger: a surface right behind it is missed
_OCCLUSION_RAYS = 16  # per pixel of the finished picture; more: less noise in the shadows, slower
_OCCLUSION_REACH = 0.4  # [m] surface nearer than this darkens a point; larger: wider shadows in corners


@dataclass(frozen=True)
class Lighting:
    """The light and the background of a picture."""

    background: tuple[float, float, float] = (1.0, 1.0, 1.0)  # RGB
    ambient: float = 0.55  # share of light that is independent of the surface's direction; 1: the colours themselves
    occlusion: float = 0.6  # darkness of corners (ambient occlusion); 0: none
    supersample: int = 2  # rays per pixel along each axis; more: smoother edges, slower


_PLAIN = Lighting(background=(0.0, 0.0, 0.0), ambient=1.0, occlusion=0.0)


class Picture:
    """A mesh prepared for pictures; without vertex colours it is light grey."""

    def __init__(self, mesh: trimesh.Trimesh, *, inside: NDArray[np.float64] | None = None) -> None:
        """inside (M, 3) [m]: points in front of the surface, such as camera centres. If given, each face is visible only from the side of
        the nearest of these points, whatever its winding in the file. Otherwise faces are visible from both sides."""
        if len(mesh.faces) == 0:
            raise ResultError("the mesh has no faces; expected a surface to draw")
        self._caster = RayCaster(mesh)
        self._faces = np.asarray(mesh.faces)
        self._colours = vertex_colours(mesh)
        self._normals = np.asarray(mesh.face_normals, np.float32)
        self._smooth = np.asarray(mesh.vertex_normals, np.float32)
        self._one_sided = inside is not None
        if inside is not None:
            centres = np.asarray(mesh.triangles_center)
            towards = inside[cKDTree(inside).query(centres, workers=-1)[1]] - centres
            flip = (towards * self._normals).sum(-1) < 0
            self._normals = np.where(flip[:, None], -self._normals, self._normals)

    def draw(self, T_wc: NDArray[np.float64], camera: Camera, lighting: Lighting = _PLAIN) -> NDArray[np.uint8]:
        """(H, W, 3) uint8 RGB seen from T_wc (4, 4)."""
        rgba = self._draw(T_wc, camera, lighting)
        return (rgba[..., :3] * 255 + 0.5).astype(np.uint8)

    def cut_out(self, T_wc: NDArray[np.float64], camera: Camera, lighting: Lighting = _PLAIN) -> NDArray[np.uint8]:
        """(H, W, 4) uint8 RGBA, transparent where there is no surface, for any background."""
        rgba = self._draw(T_wc, camera, replace(lighting, background=(0.0, 0.0, 0.0)))
        rgba[..., :3] /= np.maximum(rgba[..., 3:], 1e-3)
        return (np.clip(rgba, 0, 1) * 255 + 0.5).astype(np.uint8)

    def _draw(self, T_wc: NDArray[np.float64], camera: Camera, lighting: Lighting) -> Floats:
        """(H, W, 4): RGB over the background, and the share of each pixel that shows surface."""
        size, s = (camera.width, camera.height), lighting.supersample
        fine = camera.resized(camera.width * s, camera.height * s)
        colour = self._colour(T_wc, fine, lighting)
        return np.asarray(cv2.resize(colour.reshape(fine.height, fine.width, 4), size, interpolation=cv2.INTER_AREA))

    def depth(self, T_wc: NDArray[np.float64], camera: Camera) -> Floats:
        """Z-depth (H, W) [m], 0 where there is no surface, seen from T_wc (4, 4)."""
        origin = np.broadcast_to(T_wc[:3, 3].astype(np.float32), (camera.width * camera.height, 3))
        depth = self._first(origin, pixel_rays(camera, T_wc))[0]
        return np.where(np.isfinite(depth), depth, np.float32(0)).reshape(camera.height, camera.width)

    def _first(self, origins: Floats, rays: Floats) -> tuple[Floats, NDArray[np.int32], Floats]:
        """Distance, face and barycentric coordinates of the first visible face. Rays pass through the backs of one-sided meshes."""
        hits = self._caster.cast(origins, rays)
        distance, face, weights = hits.distance.copy(), hits.face.copy(), hits.barycentric.copy()
        open_ = np.nonzero(self._is_back(face, rays))[0]
        for _ in range(_MAX_BACK_FACES):
            if len(open_) == 0:
                break
            start = distance[open_] + _STEP
            hits = self._caster.cast(origins[open_] + rays[open_] * start[:, None], rays[open_])
            distance[open_], face[open_], weights[open_] = start + hits.distance, hits.face, hits.barycentric
            open_ = open_[self._is_back(hits.face, rays[open_])]
        distance[open_], face[open_] = np.inf, -1
        return distance, face, weights

    def _is_back(self, face: NDArray[np.int32], rays: Floats) -> NDArray[np.bool_]:
        if not self._one_sided:
            return np.zeros(len(face), bool)
        return (face >= 0) & ((self._normals[face] * rays).sum(-1) > 0)

    def _colour(self, T_wc: NDArray[np.float64], camera: Camera, lighting: Lighting) -> Floats:
        """(N, 4): shaded RGB in [0, 1] of all pixels, and 1 where there is surface."""
        rays = pixel_rays(camera, T_wc)
        origins = np.broadcast_to(T_wc[:3, 3].astype(np.float32), rays.shape)
        distance, face, weights = self._first(origins, rays)
        hit = np.nonzero(face >= 0)[0]
        corners = self._faces[face[hit]]
        w = np.concatenate([1 - weights[hit].sum(-1, keepdims=True), weights[hit]], -1)[..., None]
        rgb = (self._colours[corners] * w).sum(1)
        normal = self._facing((self._smooth[corners] * w).sum(1), self._normals[face[hit]], rays[hit])
        light = lighting.ambient + (1 - lighting.ambient) * np.abs((normal * _unit(rays[hit])).sum(-1))
        if lighting.occlusion:
            light = light * (
                1
                - lighting.occlusion
                * self._occlusion(
                    origins[hit] + rays[hit] * distance[hit, None], normal, max(1, _OCCLUSION_RAYS // lighting.supersample**2)
                )
            )
        image = np.empty((len(rays), 4), np.float32)
        image[:] = (*lighting.background, 0)
        image[hit, :3] = np.clip(rgb * light[:, None], 0, 1)
        image[hit, 3] = 1
        return image

    @staticmethod
    def _facing(smooth: Floats, flat: Floats, rays: Floats) -> Floats:
        """Unit normals that point towards the viewer: the smooth ones, or the face's own if a smooth one is degenerate."""
        normal = np.where(np.linalg.norm(smooth, axis=-1, keepdims=True) > 1e-3, smooth, flat)
        return _unit(np.where((normal * rays).sum(-1, keepdims=True) > 0, -normal, normal))

    def _occlusion(self, points: Floats, normals: Floats, rays_each: int) -> Floats:
        """(N,) cosine-weighted share of the hemisphere's light that is blocked by surface within the reach; nearer surface blocks more."""
        generator = np.random.default_rng(0)
        taken = np.zeros(len(points), np.float32)
        origins = points + normals * 2e-3
        for _ in range(rays_each):
            sphere = _unit(generator.normal(size=points.shape).astype(np.float32))
            rays = _unit(normals + 0.999 * sphere)
            distance = self._caster.cast(origins, rays).distance
            taken += np.clip(1 - distance / _OCCLUSION_REACH, 0, 1)
        return taken / rays_each


def _unit(vectors: Floats) -> Floats:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def vertex_colours(mesh: trimesh.Trimesh) -> Floats:
    """(V, 3) RGB in [0, 1]; light grey where the mesh has none."""
    if isinstance(mesh.visual, trimesh.visual.ColorVisuals) and mesh.visual.kind == "vertex":
        return np.asarray(mesh.visual.vertex_colors[:, :3], np.float32) / 255
    return np.full((len(mesh.vertices), 3), 0.75, np.float32)


def looking_at(target: NDArray[np.float64], eye: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """T_wc (4, 4) of a camera at `eye` (3,) that looks at `target` (3,)."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(z, x), z], -1)
    T[:3, 3] = eye
    return T


def pose_outside(mesh: trimesh.Trimesh, up: NDArray[np.float64], direction: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """T_wc (4, 4) in a unit direction (3,) from the mesh, as near as the whole mesh fits the image. up (3,): a unit vector."""
    low, high = np.percentile(mesh.vertices, [0.2, 99.8], axis=0)  # percentiles: a stray face must not make the room small in the picture
    centre = (low + high) / 2
    T = looking_at(centre, centre + direction, up)
    points = np.asarray(mesh.vertices)
    points = points[((points >= low) & (points <= high)).all(-1)]
    local = (points - centre) @ T[:3, :3]
    half = np.array([(camera.width - 1) / 2 / camera.fx, (camera.height - 1) / 2 / camera.fy]) * 0.95
    # |x| <= half (z + d) for every point, for the smallest distance d
    T[:3, 3] = centre + direction * float((np.abs(local[:, :2]) / half - local[:, 2:]).max())
    return T
