"""Covisibility (Eq. 5): how much of what one keyframe measured other keyframes have in view."""

from torch import Tensor

from idfslam.geometry.camera import Camera


def covisibility(
    depth: Tensor,
    camera: Camera,
    T_kn: Tensor,
    other_camera: Camera,
    other_depths: Tensor | None = None,
    *,
    subsample: int = 8,
    depth_tolerance: float = 0.1,
) -> Tensor:
    """Share (K,) of the new keyframe's measured pixels that project into each of K stored keyframes, u_k = K T_kn K^-1 u_n d_n / d_k.

    depth (H, W) [m] of the new keyframe, 0 = no reading; T_kn (K, 4, 4) takes its points into the stored keyframes' frames. Every
    `subsample`-th row and column is tested. Without a reading the shares are 0.

    Eq. 5 tests the image's bounds alone, so a keyframe on the other side of a wall counts as covisible. With `other_depths` (K, H', W')
    [m] a point must also not be hidden there: no more than `depth_tolerance` (a share of the depth) behind what that keyframe measured at
    its pixel; where that has no reading, bounds decide.
    """
    chosen = depth[::subsample, ::subsample]
    points = camera.rays(camera.pixels(depth.device)[::subsample, ::subsample]).to(depth) * chosen[..., None]
    points = points[chosen > 0]
    if len(points) == 0:
        return T_kn.new_zeros(T_kn.shape[0])
    T_kn = T_kn.to(points)
    points_k = T_kn[:, :3, :3] @ points.mT + T_kn[:, :3, 3:]  # (K, 3, N): coordinates apart in memory: project reads them faster
    uv, z = other_camera.project(points_k.mT)
    seen = other_camera.inside(uv, z)
    if other_depths is not None:
        u = uv[..., 0].round().long().clamp(0, other_camera.width - 1)
        v = uv[..., 1].round().long().clamp(0, other_camera.height - 1)
        measured = other_depths.flatten(1).gather(1, v * other_camera.width + u)
        seen &= (measured <= 0) | (z <= measured * (1 + depth_tolerance))
    return seen.float().mean(1)
