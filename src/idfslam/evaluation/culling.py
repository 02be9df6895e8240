"""What of a surface a camera saw: the rules by which the evaluation protocols remove the rest.

The rules follow the published scripts: a point is in a view's frustum if it projects inside the image within the depth range; it is
unoccluded if besides z < rendered depth + margin. A face is kept if any of its vertices is. Depth is cast only at pixels on which a
point falls that no earlier view has seen: the same answer as rendering every view, at a fraction of the rays.
"""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.evaluation.depth_range import DepthRange
from idfslam.evaluation.raycasting import RayCaster, pixel_rays
from idfslam.geometry.camera import Camera

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
    seen = np.zeros(len(points), bool)
    remaining, local_points = np.arange(len(points)), np.asarray(points, np.float32)
    for T_wc in poses:
        found = _in_view(local_points, T_wc, camera, rule, occluder)
        seen[remaining[found]] = True
        if found.any():
            remaining, local_points = remaining[~found], local_points[~found]
    return seen


def _in_view(points: NDArray[np.float32], T_wc: NDArray[np.float64], camera: Camera, rule: Visibility, occluder: RayCaster | None) -> Mask:
    local = (points - T_wc[:3, 3].astype(np.float32)) @ T_wc[:3, :3].astype(np.float32)
    found = (local[:, 2] > rule.near) & (local[:, 2] < rule.far)
    index = np.nonzero(found)[0]
    x, y, z = local[index].T
    u, v = np.rint(x / z * camera.fx + camera.cx), np.rint(y / z * camera.fy + camera.cy)
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    found[index[~inside]] = False
    if occluder is None:
        return found
    index, z = index[inside], z[inside]
    pixel = v[inside].astype(np.int64) * camera.width + u[inside].astype(np.int64)
    depth = np.zeros(camera.width * camera.height, np.float32)
    depth[pixel] = 1
    wanted = np.nonzero(depth)[0]
    distance = occluder.cast(T_wc[:3, 3].astype(np.float32), pixel_rays(camera, T_wc, wanted)).distance
    # A pixel without surface, or with surface beyond the far plane, has depth 0 in the published scripts: nothing is seen there
    depth[wanted] = np.where(distance < rule.far, distance, 0)
    found[index] = z < depth[pixel] + rule.margin
    return found


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
