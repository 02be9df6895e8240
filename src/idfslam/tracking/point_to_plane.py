"""Projective point-to-plane ICP of two depth images (Chen and Medioni 1992; Blais and Levine 1995), constrained by matched points.

Matched features give the initial pose, to about a pixel of the features. The surfaces then give the exact pose. Where surfaces can slide on
each other (a bare wall), the matches constrain the pose.
"""

import numpy as np
import torch
from torch import Tensor

from idfslam.compute.backend import pick
from idfslam.geometry import se3
from idfslam.sensing.depth_noise import BEST, difference_noise
from idfslam.tracking.correspondences import Correspondences
from idfslam.tracking.frame_features import FrameFeatures

# Chosen by hand on pairs of frames (docs/model-card.md).
_STRIDE = 4  # [px] stride of the frame's rows and columns in all but the last steps. More: faster, and noisier first steps
_FINE_STEPS = 2  # number of last steps, in which all rows and columns take part. More: slower, hardly more exact
# [m] Largest distance of a point from its plane, in the first and in the last step. More: worse first poses are corrected, and more
# outliers take part.
_REACH = (0.10, 0.03)
_FACING = 0.8  # [1] least cosine between the normals of a pair. More: fewer wrong pairs, and fewer pairs
_MATCH_NOISE = 0.01  # [m] noise of a match, added to the sensor's: a pixel of the features, seen from 2 m. More: matches count less
_MATCH_WEIGHT = 0.1  # [1] weight of a match relative to a point: errors of neighbouring matches are correlated. More: matches count more
_PRIOR = 1.0  # [1/m^2, 1/rad^2] prior information at the present pose; raised, steps are shorter. It keeps the system solvable; a point
#    has about 10^4
_ROBUST = 3.0  # [standard deviations] residual at which the weight has fallen to a quarter. More: outliers count more


@torch.no_grad()
def point_to_plane(T_kc: Tensor, frame: FrameFeatures, keyframe: FrameFeatures, matches: Correspondences, *, steps: int) -> Tensor:
    """T_kc (4, 4) float64 after `steps` steps of Gauss-Newton from a T_kc that is exact to a few cm."""
    for step in range(steps):
        stride = 1 if step >= steps - _FINE_STEPS else _STRIDE
        reach = _REACH[0] + step / max(steps - 1, 1) * (_REACH[1] - _REACH[0])
        H, b = plane_system(T_kc, frame, keyframe, stride, reach)
        H_matches, b_matches = _match_system(T_kc, matches)
        prior = _PRIOR * torch.eye(6).to(H)
        T_kc = se3.exp(torch.linalg.solve(H + H_matches + prior, b + b_matches)) @ T_kc
    return se3.orthonormal(T_kc)


def plane_system(T_kc: Tensor, frame: FrameFeatures, keyframe: FrameFeatures, stride: int, reach: float) -> tuple[Tensor, Tensor]:
    """Normal equations H (6, 6), b (6,) of the distances of the frame's points to the keyframe's planes that they project to.

    Every `stride`-th row and column takes part, and distances up to `reach` [m].
    """
    return pick(frame.points, compiled=compiled_plane_system, plain=plain_plane_system)(T_kc, frame, keyframe, stride, reach)


def compiled_plane_system(T_kc: Tensor, frame: FrameFeatures, keyframe: FrameFeatures, stride: int, reach: float) -> tuple[Tensor, Tensor]:
    """`plane_system` by Numba, on the CPU."""
    from idfslam.tracking.kernels import numba_tracking

    c, H, b = keyframe.camera, torch.zeros(6, 6, dtype=torch.float64), torch.zeros(6, dtype=torch.float64)
    images = [image.numpy() for image in (frame.points, frame.normals, keyframe.points, keyframe.normals)]
    camera = np.array([c.fx, c.fy, c.cx, c.cy], np.float32)
    numbers = (np.float32(value) for value in (reach, _FACING, 2**0.5 * BEST, _ROBUST))
    numba_tracking.plane_system(T_kc.float().numpy(), *images[:2], stride, *images[2:], camera, *numbers, H.numpy(), b.numpy())  # type: ignore[call-arg]
    return H, b


def plain_plane_system(T_kc: Tensor, frame: FrameFeatures, keyframe: FrameFeatures, stride: int, reach: float) -> tuple[Tensor, Tensor]:
    """`plane_system` in torch, on any device."""
    points, normals = _surface(frame, stride)
    T, camera = T_kc.to(points), keyframe.camera
    moved, turned = se3.transform(T, points), normals @ T[:3, :3].T
    uv, z = camera.project(moved)
    inside = camera.inside(uv, z)
    u, v = uv.round().long().where(inside[:, None], 0).unbind(-1)
    offset, normal = moved - keyframe.points[v, u], keyframe.normals[v, u]
    distance = (offset * normal).sum(-1)
    near = (distance.abs() < reach) & (offset.norm(dim=-1) < 2 * reach)
    sigma = difference_noise(z)
    weight = (inside & near & ((turned * normal).sum(-1) > _FACING)) * _robust(distance, sigma)
    J = torch.cat([normal, torch.linalg.cross(moved, normal)], -1)
    JtW = (J * weight[:, None]).T
    return (JtW @ J).double(), -(JtW @ distance).double()


def _surface(frame: FrameFeatures, stride: int) -> tuple[Tensor, Tensor]:
    """Points (N, 3) and normals (N, 3) of every `stride`-th row and column, where there is a normal."""
    inside = slice(stride // 2, None, stride)
    points, normals = (image[inside, inside].flatten(0, 1) for image in (frame.points, frame.normals))
    valid = normals[:, 2] != 0
    return points[valid], normals[valid]


def _match_system(T_kc: Tensor, matches: Correspondences) -> tuple[Tensor, Tensor]:
    """Normal equations H (6, 6), b (6,) of the differences between matched points."""
    moved, target = se3.transform(T_kc, matches.frame.to(T_kc)), matches.keyframe.to(T_kc)
    difference = moved - target
    weight = _MATCH_WEIGHT * _robust(difference.norm(dim=-1), difference_noise(target[:, 2]) + _MATCH_NOISE)
    J = torch.cat([torch.eye(3).to(T_kc).expand(len(moved), 3, 3), -se3.hat(moved)], -1)
    JtW = (J * weight[:, None, None]).flatten(0, 1).T
    return JtW @ J.flatten(0, 1), -JtW @ difference.flatten()


def _robust(residual: Tensor, sigma: Tensor) -> Tensor:
    """Weights of the Geman-McClure kernel, divided by the variance."""
    return 1 / (sigma * (1 + (residual / (_ROBUST * sigma)) ** 2)) ** 2
