"""Covisibility (Eq. 5): the share of one keyframe's measured pixels that other keyframes have in view."""

from collections.abc import Sequence

import torch
from torch import Tensor

from idfslam.compute.backend import Backend, backend_of
from idfslam.geometry.camera import Camera, indices_by_camera


def covisibility(
    depth: Tensor,
    camera: Camera,
    T_kn: Tensor,
    other_cameras: Sequence[Camera],
    other_depths: Sequence[Tensor] | None = None,
    *,
    subsample: int = 8,
    depth_tolerance: float = 0.1,
) -> Tensor:
    """Share (K,) of the new keyframe's measured pixels that project into each of K stored keyframes, u_k = K T_kn K^-1 u_n d_n / d_k.

    depth (H, W) [m] is that of the new keyframe, 0 = no reading. T_kn (K, 4, 4) transforms its points into the stored keyframes' frames.
    Every `subsample`-th row and column is tested. Without a reading the shares are 0. `other_cameras` are the K cameras of the stored
    keyframes: a map may come from recordings of several cameras.

    Eq. 5 tests the bounds of the image only, so a keyframe on the other side of a wall counts as covisible. With `other_depths`, K images
    (H', W') [m], a point must also not be occluded: it is at most `depth_tolerance` (a share of the depth) behind the stored keyframe's
    reading at its pixel. Without a reading there, the bounds decide.
    """
    points = sampled_points(depth, camera, subsample)
    shares = T_kn.new_zeros(len(T_kn), dtype=torch.float32)
    if len(points) == 0:
        return shares
    for other, members in indices_by_camera(other_cameras).items():
        T = T_kn[members]
        if other_depths is None and backend_of(points.device) is Backend.NUMBA:
            shares[members] = compiled_in_view(points, T, other) / len(points)
        else:
            depths = None if other_depths is None else torch.stack([other_depths[i] for i in members])
            shares[members] = plain_in_view(points, T, other, depths, depth_tolerance).float().mean(1)
    return shares


def sampled_points(depth: Tensor, camera: Camera, subsample: int) -> Tensor:
    """Points (N, 3) [m] in the camera's frame of every `subsample`-th row and column that has a reading."""
    chosen = depth[::subsample, ::subsample]
    points = camera.rays(camera.pixels(depth.device)[::subsample, ::subsample]).to(depth) * chosen[..., None]
    return points[chosen > 0]


def plain_in_view(points: Tensor, T_kn: Tensor, camera: Camera, depths: Tensor | None = None, depth_tolerance: float = 0.1) -> Tensor:
    """Which (K, N) of the points (N, 3) each of K views has in view; with depths (K, H, W), points behind the readings are left out."""
    T_kn = T_kn.to(points)
    points_k = T_kn[:, :3, :3] @ points.mT + T_kn[:, :3, 3:]  # (K, 3, N): each coordinate is contiguous, so `project` reads it faster
    uv, z = camera.project(points_k.mT)
    seen = camera.inside(uv, z)
    if depths is not None:
        u = uv[..., 0].round().long().clamp(0, camera.width - 1)
        v = uv[..., 1].round().long().clamp(0, camera.height - 1)
        measured = depths.flatten(1).gather(1, v * camera.width + u)
        seen &= (measured <= 0) | (z <= measured * (1 + depth_tolerance))
    return seen


def compiled_in_view(points: Tensor, T_kn: Tensor, camera: Camera) -> Tensor:
    """The number (K,) of the points (N, 3) that each of K views has in view, by the five planes of its frustum, without a division."""
    from idfslam.graph.kernels.numba_covisibility import in_view

    x, y, z = T_kn[:, 0], T_kn[:, 1], T_kn[:, 2]  # (K, 4): rows that give a point's coordinates in each camera
    left, right = camera.fx * x + (camera.cx + 0.5) * z, (camera.width - 0.5 - camera.cx) * z - camera.fx * x
    top, bottom = camera.fy * y + (camera.cy + 0.5) * z, (camera.height - 0.5 - camera.cy) * z - camera.fy * y
    sides = torch.stack([left, right, top, bottom, z], 1).float().contiguous()
    counts = torch.zeros(len(T_kn), dtype=torch.int64)
    coordinates = points.float().T.contiguous().numpy()
    in_view(*coordinates, sides.numpy(), counts.numpy())  # type: ignore[call-arg]
    return counts
