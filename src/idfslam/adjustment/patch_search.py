"""Where another image shows the patches of a keyframe, to a fraction of a pixel, at poses that are right to about five pixels."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.observations import Array, Indices
from idfslam.compute.backend import pick
from idfslam.geometry.camera import Camera
from idfslam.tracking.patch_alignment import align_patches
from idfslam.tracking.patches import GRAZING, Patches

# All of these but the last were chosen by hand.
_MIN_CORRELATION = 0.85  # [1] least correlation of a patch with the image; raised, fewer and surer measurements
_FLOOR = 0.05  # [px] least standard deviation of a position, for what patches do not show; more: sharp patches count less
_STRETCH = 0.3, 3.0  # [1] least and largest ratio of a patch's areas in two images; wider: patches seen more sideways take part
_NEAREST = 0.1  # [m] least depth of a point; more: fewer
_PIXELS = (2 * 5 + 1) ** 2  # of a patch of `align_patches`: a fact of it


@dataclass(frozen=True)
class Found:
    """M patches that another image shows."""

    patch: Indices  # (M,) their numbers
    uv: Array  # (M, 2) [px] where
    covariance: Array  # (M, 2, 2) [px^2] of that
    z: Array  # (M,) [m] depth at which the pose puts them


@dataclass(frozen=True)
class Predicted:
    """M patches that another image may show, as far as the pose tells."""

    patch: Indices  # (M,) their numbers
    start: Tensor  # (M, 2) float32 [px] where they are looked for
    warp: Tensor  # (M, 2, 2) float32 pixels of the patch's image along those of the other
    z: Array  # (M,) [m] their depth in the other


def search(patches: Patches, image: Tensor, other: Tensor, T_oh: Array, model: CameraModel) -> Found:
    """The patches of an image (H, W) uint8 that another one, of a camera at T_oh (4, 4) in its frame, shows.

    The noise of an image is in both: half of the covariance of the difference belongs to each.
    """
    predicted = predict(patches, T_oh, model)
    if not len(predicted.patch):
        return Found(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0))
    at, H, correlation = align_patches(image, other, patches.uv[torch.from_numpy(predicted.patch)].float(), predicted.warp, predicted.start)
    good = (correlation > _MIN_CORRELATION).numpy()
    variance = (1 - correlation.numpy()[good].astype(np.float64)) / _PIXELS
    covariance = inverses(H.numpy()[good].astype(np.float64)) * variance[:, None, None] + _FLOOR**2 * np.eye(2)
    return Found(predicted.patch[good], at.numpy()[good].astype(np.float64), covariance, predicted.z[good])


def inverses(H: Array) -> Array:
    """The inverses of symmetric matrices (N, 2, 2). One at a time they take ten times as long."""
    a, b, c = H[:, 0, 0], H[:, 0, 1], H[:, 1, 1]
    return np.stack([c, -b, -b, a], 1).reshape(-1, 2, 2) / (a * c - b * b)[:, None, None]


def predict(patches: Patches, T_oh: Array, model: CameraModel) -> Predicted:
    """Where patches are to be looked for in another image, of a camera at T_oh (4, 4) in the frame of theirs."""
    return pick(patches.uv, compiled=compiled_predict, plain=plain_predict)(patches, T_oh, model)


def compiled_predict(patches: Patches, T_oh: Array, model: CameraModel) -> Predicted:
    """`predict` by Numba, on the CPU."""
    from idfslam.adjustment.kernels import numba_patch_prediction

    n, c = len(patches), model.camera
    number, start, warp, z = np.empty(n, np.int64), np.empty((n, 2), np.float32), np.empty((n, 2, 2), np.float32), np.empty(n)
    arrays = (array.double().numpy() for array in (patches.uv, patches.points, patches.normals))
    camera, limits = (c.width, c.height, c.fx, c.fy, c.cx, c.cy), (_NEAREST, GRAZING, *_STRETCH)
    where = np.ascontiguousarray(T_oh), camera, model.distortion
    count = numba_patch_prediction.predict(*arrays, *where, limits, number, start, warp, z)  # type: ignore[call-arg]
    return Predicted(number[:count], torch.from_numpy(start[:count]), torch.from_numpy(warp[:count]), z[:count])


def plain_predict(patches: Patches, T_oh: Array, model: CameraModel) -> Predicted:
    """`predict` in numpy."""
    camera, R, t = model.camera, T_oh[:3, :3], T_oh[:3, 3]
    uv, points, normals = patches.uv.numpy(), patches.points.numpy(), patches.normals.numpy()
    moved = points @ R.T + t
    z = moved[:, 2]
    flat = _projected(camera, moved)
    start = model.project(np.maximum(moved, -1e6))[0] if any(model.distortion) else flat
    beside = [_projected(camera, _on_planes(camera, uv + step, points, normals) @ R.T + t) - flat for step in np.eye(2)]
    (a, c), (b, d) = beside[0].T, beside[1].T  # pixels of the other image along those of this one
    area = a * d - b * c
    inside = (start > -0.5).all(1) & (start[:, 0] < camera.width - 0.5) & (start[:, 1] < camera.height - 0.5)
    seen = np.flatnonzero(inside & (z > _NEAREST) & (area > _STRETCH[0]) & (area < _STRETCH[1]))
    warp = (np.stack([d, -b, -c, a], 1)[seen] / area[seen, None]).reshape(-1, 2, 2)
    start_of_seen, warp_of_seen = (torch.from_numpy(array.astype(np.float32)) for array in (start[seen], warp))
    return Predicted(seen, start_of_seen, warp_of_seen, z[seen])


def _projected(camera: Camera, points: Array) -> Array:
    """The pixels (N, 2) of points (N, 3) [m] in the camera's frame, without distortion."""
    z = np.where(np.abs(points[:, 2]) < 1e-9, 1e-9, points[:, 2])
    return np.asarray(points[:, :2] / z[:, None] * [camera.fx, camera.fy] + [camera.cx, camera.cy])


def _on_planes(camera: Camera, uv: Array, points: Array, normals: Array) -> Array:
    """`Patches.on_planes`: where the rays of pixels uv (N, 2) meet the planes of points (N, 3) with normals (N, 3)."""
    rays = np.concatenate([(uv - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones((len(uv), 1))], 1)
    facing = np.minimum((rays * normals).sum(1), -GRAZING)
    return np.asarray(rays * ((points * normals).sum(1) / facing)[:, None])


def root_of(covariance: Array) -> Array:
    """Matrices (N, 2, 2) R with R^T R the inverse of a covariance (N, 2, 2)."""
    return np.linalg.inv(np.linalg.cholesky(covariance)) if len(covariance) else covariance
