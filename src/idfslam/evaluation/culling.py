"""What of a surface a camera saw: the rules by which the evaluation protocols remove the rest.

The rules follow the published scripts: a point is in a view's frustum if it projects inside the image within the depth range; it is
unoccluded if besides z < rendered depth + margin. A face is kept if any of its vertices is. Depth is cast only at pixels on which a
point falls that no earlier view has seen: the same answer as rendering every view, at a fraction of the rays.
"""

from dataclasses import astuple, dataclass, replace

import numpy as np
import trimesh
from numba import njit
from numpy.typing import NDArray

from idfslam.evaluation.depth_range import DepthRange
from idfslam.geometry.camera import Camera
from idfslam.geometry.ray_casting import RayCaster, pixel_rays

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Visibility:
    """The depth range of a view and the slack of the occlusion test [m]."""

    near: float
    far: float
    margin: float

    def within(self, readings: DepthRange) -> "Visibility":
        """The same rule for no more than the depths that a sensor reads."""
        return replace(self, near=max(self.near, readings.near), far=min(self.far, readings.far))


def in_any_view(
    points: NDArray[np.float64], poses: NDArray[np.float64], camera: Camera, rule: Visibility, *, occluder: RayCaster | None = None
) -> Mask:
    """(V,) whether points (V, 3) [m] are in the frustum of a view of poses (N, 4, 4) and, where an occluder is given, unoccluded in it."""
    seen = np.zeros(len(points), np.bool_)
    points = np.asarray(points, np.float64)  # bare: trimesh hands out arrays of its own kind
    # Neighbouring views show the same: in random order most of what is seen at all is found in the first few
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
    """Of the points (V, 3) that are not seen yet, those in the frustum: index, flat index of the pixel, z-depth [m], (M,) each."""
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
        u = np.rint((p * T_wc[0, 0] + q * T_wc[1, 0] + r * T_wc[2, 0]) / z * fx + cx)
        v = np.rint((p * T_wc[0, 1] + q * T_wc[1, 1] + r * T_wc[2, 1]) / z * fy + cy)
        if 0 <= u < width and 0 <= v < height:
            index[count], pixel[count], depth[count] = i, int(v) * width + int(u), z
            count += 1
    return index[:count], pixel[:count], depth[:count]


def _depth(occluder: RayCaster, pixel: NDArray[np.int64], T_wc: NDArray[np.float64], camera: Camera, far: float) -> NDArray[np.float32]:
    """(M,) z-depth [m] of the occluder at flat pixel indices (M,), each pixel cast once.

    A pixel without surface, or with surface beyond the far plane, has depth 0 as in the published scripts: nothing is seen there.
    """
    asked = np.zeros(camera.width * camera.height, np.bool_)
    asked[pixel] = True
    wanted = np.nonzero(asked)[0]
    depth = np.zeros(len(asked), np.float32)
    distance = occluder.cast(T_wc[:3, 3].astype(np.float32), pixel_rays(camera, T_wc, wanted)).distance
    depth[wanted] = np.where(distance < far, distance, 0)
    return depth[pixel]


def subdivided(mesh: trimesh.Trimesh, *, max_edge: float = 0.1) -> trimesh.Trimesh:
    """The same surface with no edge longer than `max_edge` [m], so that a wall of two triangles can be culled in part."""
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, max_edge, max_iter=20)
    return trimesh.Trimesh(vertices, faces, process=False)


def faces_kept(mesh: trimesh.Trimesh, kept: Mask) -> Mask:
    """(F,) the faces with at least one of the kept vertices (V,)."""
    return np.asarray(kept[mesh.faces].any(1))


def submesh(mesh: trimesh.Trimesh, faces: Mask) -> trimesh.Trimesh:
    """The faces (F,) of a mesh, with their vertices only."""
    result = trimesh.Trimesh(mesh.vertices, mesh.faces[faces], process=False)
    result.remove_unreferenced_vertices()
    return result


def virtual_views(truth: RayCaster, poses: NDArray[np.float64], *, positions: int, reach: float, seed: int) -> NDArray[np.float64]:
    """(6 * positions, 4, 4) cameras in the free space around the recorded ones, looking in six directions each (90 degrees wide).

    They stand up to `reach` [m] from recorded camera centres, in line of sight of these, so never behind a wall.
    """
    faces = [np.eye(3)[:, order] * sign for order in ([0, 1, 2], [1, 2, 0], [2, 0, 1]) for sign in (1, [-1, 1, -1])]
    views = np.tile(np.eye(4), (positions, 6, 1, 1))
    views[:, :, :3, :3] = faces
    views[:, :, :3, 3] = free_positions(truth, poses, count=positions, reach=reach, seed=seed)[:, None]
    return views.reshape(-1, 4, 4)


def free_positions(truth: RayCaster, poses: NDArray[np.float64], *, count: int, reach: float, seed: int) -> NDArray[np.float64]:
    """(count, 3) [m] positions up to `reach` from camera centres of poses (N, 4, 4), with nothing between the two."""
    generator = np.random.default_rng(seed)
    centres = poses[generator.integers(len(poses), size=count), :3, 3]
    offset = generator.normal(size=(count, 3))
    offset *= reach * generator.random((count, 1)) ** (1 / 3) / np.linalg.norm(offset, axis=1, keepdims=True)
    distance = truth.cast(centres.astype(np.float32), offset.astype(np.float32)).distance  # in units of the offset
    return centres + offset * np.minimum(1, 0.7 * distance)[:, None]
