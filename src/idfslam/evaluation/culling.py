"""Culling: the rules by which the evaluation protocols remove surface that no camera saw.

The rules follow the published scripts. A point is in a view's frustum if it projects into the image within the depth range. It is
unoccluded if, in addition, z < rendered depth + margin. A face is kept if any of its vertices is kept.

Depth is cast only at pixels of points that no earlier view has seen. The result is the same as that of rendering every view.
"""

from dataclasses import astuple, dataclass, replace

import numpy as np
import trimesh
from numba import njit
from numpy.typing import NDArray

from idfslam.evaluation.depth_range import DepthRange
from idfslam.geometry.camera import Camera
from idfslam.geometry.projection import to_pixel
from idfslam.geometry.ray_casting import RayCaster, pixel_rays

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Visibility:
    """When a point counts as visible: the depth range of a view and the margin of the occlusion test [m]."""

    near: float
    far: float
    margin: float

    def limited_to(self, sensor_range: DepthRange) -> "Visibility":
        """The same rule, limited to the depths that a sensor reads."""
        return replace(self, near=max(self.near, sensor_range.near), far=min(self.far, sensor_range.far))


def in_any_view(
    points: NDArray[np.float64], poses: NDArray[np.float64], camera: Camera, rule: Visibility, *, occluder: RayCaster | None = None
) -> Mask:
    """(V,) whether each point (V, 3) [m] is visible from any of the camera-to-world poses (N, 4, 4).

    Visible means in the frustum and, if an occluder is given, not hidden by it.
    """
    seen = np.zeros(len(points), np.bool_)
    points = np.asarray(points, np.float64)  # trimesh returns a subclass that Numba does not accept
    # Neighbouring views show the same points. In random order the first few views already show most of those that are ever seen
    for T_wc in poses[np.random.default_rng(0).permutation(len(poses))]:
        index, pixel, z = _in_frustum(points, seen, T_wc, astuple(camera), rule.near, rule.far)
        if occluder is not None:
            index = index[z < _depth(occluder, pixel, T_wc, camera, rule.far) + rule.margin]
        seen[index] = True
    return seen


@njit(cache=True, nogil=True, error_model="numpy")
def _in_frustum(
    points: NDArray[np.float64],
    seen: Mask,
    T_wc: NDArray[np.float64],
    camera: tuple[int, int, float, float, float, float],
    near: float,
    far: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """The M points of (V, 3) that are in the frustum and not yet seen: their indices, flat pixel indices and z-depths [m], (M,) each."""
    width, height, fx, fy, cx, cy = camera
    index, pixel, depth = np.empty(len(points), np.int64), np.empty(len(points), np.int64), np.empty(len(points))
    count = 0
    for i in range(len(points)):
        if seen[i]:
            continue
        p, q, r = points[i, 0] - T_wc[0, 3], points[i, 1] - T_wc[1, 3], points[i, 2] - T_wc[2, 3]
        z = p * T_wc[0, 2] + q * T_wc[1, 2] + r * T_wc[2, 2]
        if not near < z < far:
            continue
        x = p * T_wc[0, 0] + q * T_wc[1, 0] + r * T_wc[2, 0]
        y = p * T_wc[0, 1] + q * T_wc[1, 1] + r * T_wc[2, 1]
        u, v = to_pixel(x, y, z, fx, fy, cx, cy)
        u, v = np.rint(u), np.rint(v)
        if 0 <= u < width and 0 <= v < height:
            index[count], pixel[count], depth[count] = i, int(v) * width + int(u), z
            count += 1
    return index[:count], pixel[:count], depth[:count]


def _depth(occluder: RayCaster, pixel: NDArray[np.int64], T_wc: NDArray[np.float64], camera: Camera, far: float) -> NDArray[np.float32]:
    """(M,) z-depth [m] of the occluder at flat pixel indices (M,); each pixel is cast once.

    A pixel without surface, or with surface beyond the far plane, has depth 0 as in the published scripts: it shows no point.
    """
    is_needed = np.zeros(camera.width * camera.height, np.bool_)
    is_needed[pixel] = True
    needed = np.nonzero(is_needed)[0]
    depth = np.zeros(len(is_needed), np.float32)
    distance = occluder.cast(T_wc[:3, 3].astype(np.float32), pixel_rays(camera, T_wc, needed)).distance
    depth[needed] = np.where(distance < far, distance, 0)
    return depth[pixel]


def subdivided(mesh: trimesh.Trimesh, *, max_edge: float = 0.1) -> trimesh.Trimesh:
    """The same surface with no edge longer than `max_edge` [m], so that a wall of two triangles can be culled partly."""
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, max_edge, max_iter=20)
    return trimesh.Trimesh(vertices, faces, process=False)


def faces_kept(mesh: trimesh.Trimesh, kept: Mask) -> Mask:
    """(F,) whether each face has at least one kept vertex; `kept` is (V,)."""
    return np.asarray(kept[mesh.faces].any(1))


def submesh(mesh: trimesh.Trimesh, faces: Mask) -> trimesh.Trimesh:
    """The mesh of the selected faces (F,) and their vertices."""
    result = trimesh.Trimesh(mesh.vertices, mesh.faces[faces], process=False)
    result.remove_unreferenced_vertices()
    return result


def virtual_views(truth: RayCaster, poses: NDArray[np.float64], *, positions: int, reach: float, seed: int) -> NDArray[np.float64]:
    """(6 * positions, 4, 4) poses of virtual cameras in the free space around the recorded ones, six at each position.

    The six look along both directions of each axis; 90 degrees wide, they see everything around. Positions are up to `reach` [m] from
    recorded camera centres and in line of sight of them, so never behind a wall.
    """
    faces = [np.eye(3)[:, order] * sign for order in ([0, 1, 2], [1, 2, 0], [2, 0, 1]) for sign in (1, [-1, 1, -1])]
    views = np.tile(np.eye(4), (positions, 6, 1, 1))
    views[:, :, :3, :3] = faces
    views[:, :, :3, 3] = free_positions(truth, poses, count=positions, reach=reach, seed=seed)[:, None]
    return views.reshape(-1, 4, 4)


def free_positions(truth: RayCaster, poses: NDArray[np.float64], *, count: int, reach: float, seed: int) -> NDArray[np.float64]:
    """(count, 3) random positions [m], up to `reach` [m] from camera centres of the poses (N, 4, 4), with no surface between the two."""
    generator = np.random.default_rng(seed)
    centres = poses[generator.integers(len(poses), size=count), :3, 3]
    offset = generator.normal(size=(count, 3))
    offset *= reach * generator.random((count, 1)) ** (1 / 3) / np.linalg.norm(offset, axis=1, keepdims=True)
    distance = truth.cast(centres.astype(np.float32), offset.astype(np.float32)).distance  # in units of the offset
    return centres + offset * np.minimum(1, 0.7 * distance)[:, None]
