"""Landmarks without depth: corners where the sensor has no reading, mostly since they are beyond its reach.

Their directions hold rotations where depth is scarce. How far away a corner is follows from the keyframes that see it. Each of them, the
nearest first, narrows an interval of its inverse depth, which moves its image linearly (Civera, Davison and Montiel, 2008). Its patch is
tried at several inverse depths of the interval, some pixels apart along the epipolar line.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.landmark_tracks import KeyframeView, found_in, sightings, with_readings
from idfslam.adjustment.observations import Array, Observations, joined, together
from idfslam.tracking.frame_features import FrameFeatures
from idfslam.tracking.patches import Patches

# All of these were chosen by hand on rooms larger than a Kinect's reach.
_CLEAR = 6  # [px] around a corner without any reading, what moves, or black: its patch and a pixel more. More: fewer, farther from edges
_CELLS = 15  # cells in a column of the image, each of which has at most one corner. More: more corners, slower
_WINDOW = 5  # [px] in which a corner is measured. More: larger corners, less exactly placed
_LEAST_CORNER = 0.01  # [1] least strength of a corner, as a share of the image's strongest. More: fewer corners, with more contrast
_NEAREST = 1.0  # [m] least depth of a corner. More: faster, and near holes in depth have no landmarks
_FARTHEST = 1000.0  # [m] at which a patch is tried instead of at infinity, which is the same in a room
_LOOK_ALIKE = 25.0  # [degrees] largest angle between two keyframes' views. More: longer tracks, slower
_NEIGHBOURS = 8  # most keyframes in which a corner is looked for. More: longer tracks, slower
_STEP = 4.0  # [px] along the epipolar line between two tries. More: faster, and patches converge less often
_MOST_TRIES = 10  # of a patch in one keyframe. More: slower, and corners of unknown depth are found farther away
_MARGIN = 1.5  # [px] by which a place in a keyframe of inexact pose may be off along the line. More: intervals stay wider
_OFF_LINE = 4.0  # [px] the same beside the line. More: worse poses are mended, and more patches are found wrongly
_SIGHTINGS = 4  # least of a landmark, with its host's. More: fewer and surer landmarks


def distant_landmarks(
    views: Sequence[KeyframeView], images: Sequence[FrameFeatures], poses: Array, model: CameraModel
) -> tuple[Array, Observations]:
    """Landmarks (L, 3) [m] in the world that their hosts have no depth of, and where keyframes at poses T_wk (K, 4, 4) see them.

    images: `features_of` views and model.
    """
    points, seen = together([_hosted(k, _corners(view), images, poses, model) for k, view in enumerate(views)])
    seen = with_readings(views, seen)
    clear = np.zeros(len(seen), bool)
    for k, view in enumerate(views):
        of_view = seen.keyframe == k
        u, v = np.rint(seen.uv[of_view]).astype(np.int64).T
        rows, columns = view.grey.shape
        clear[of_view] = _open(view)[v.clip(0, rows - 1), u.clip(0, columns - 1)]
    return points, seen[clear | (seen.reading > 0)]  # at the edge of what has depth, two surfaces are in the patch


def _open(view: KeyframeView) -> NDArray[np.bool_]:
    """(H, W) the pixels of a view around which there is no reading, nothing that moves, and no border that an undistorted image has."""
    closed = (view.depth > 0) | (view.grey == 0)
    if view.moving is not None:
        closed |= view.moving
    size = 2 * _CLEAR + 1
    return np.asarray(cv2.dilate(closed.astype(np.uint8), np.ones((size, size), np.uint8), borderValue=1) == 0)


def _corners(view: KeyframeView) -> Array:
    """(N, 2) [px] the best corner of each cell of a view, where it is open."""
    half = cv2.pyrDown(view.grey)
    strength = cv2.cornerMinEigenVal(half, _WINDOW)
    strongest = max(float(strength.max()), 1e-12)
    (rows, columns), cell = half.shape, max(half.shape[0] // _CELLS, 1)
    strength = strength * _open(view)[::2, ::2][:rows, :columns]
    down, across = rows // cell, columns // cell
    cells = strength[: down * cell, : across * cell].reshape(down, cell, across, cell).transpose(0, 2, 1, 3).reshape(down * across, -1)
    best, number = cells.argmax(1), np.arange(len(cells))
    uv = 2.0 * np.stack([number % across * cell + best % cell, number // across * cell + best // cell], 1)
    return uv[cells.max(1) > _LEAST_CORNER * strongest]


@dataclass
class _Rays:
    """N corners of a host, and the interval in which the inverse depth of each lies."""

    uv: Array  # (N, 2) [px]
    rays: Array  # (N, 3) with z = 1
    least: Array  # (N,) [1/m]
    most: Array  # (N,) [1/m]

    def at(self, share: float) -> Patches:
        """Patches that face the camera, at this share of the intervals."""
        inverse = np.maximum(self.least + share * (self.most - self.least), 1 / _FARTHEST)
        normals = -self.rays / np.linalg.norm(self.rays, axis=1, keepdims=True)
        return Patches(torch.from_numpy(self.uv), torch.from_numpy(self.rays / inverse[:, None]), torch.from_numpy(normals))

    def narrow(self, found: NDArray[np.bool_], uv: Array, T_oh: Array, model: CameraModel) -> NDArray[np.bool_]:
        """Narrows the intervals of corners that another keyframe, at T_oh (4, 4), shows at pixels uv (N, 2). Which of these fit them."""
        middle = self.at(0.5).points.numpy()
        start, by_point, _ = model.project(middle @ T_oh[:3, :3].T + T_oh[:3, 3])
        by_inverse = -np.einsum("nij,nj->ni", by_point, middle @ T_oh[:3, :3].T) * middle[:, 2:]
        square = np.maximum((by_inverse**2).sum(1), 1e-9)
        change = (by_inverse * (uv - start)).sum(1) / square
        beside = np.linalg.norm(uv - start - by_inverse * change[:, None], axis=1)
        inverse, margin = 1 / middle[:, 2] + change, _MARGIN / np.sqrt(square)
        least, most = np.maximum(self.least, inverse - margin), np.minimum(self.most, inverse + margin)
        fits = found & (beside < _OFF_LINE) & (least < most)
        self.least, self.most = np.where(fits, least, self.least), np.where(fits, most, self.most)
        return np.asarray(fits)


def _hosted(k: int, uv: Array, images: Sequence[FrameFeatures], poses: Array, model: CameraModel) -> tuple[Array, Observations]:
    """The landmarks (L, 3) [m] of keyframe k's corners (N, 2), and their sightings, without readings."""
    T_ok = np.linalg.inv(poses) @ poses[k]
    corners = _Rays(uv, model.rays(uv), least=np.zeros(len(uv)), most=np.full(len(uv), 1 / _NEAREST))
    count, spread = np.zeros(len(uv)), np.zeros((len(uv), 2, 2))
    found = []
    for j in _neighbours(k, T_ok) if len(uv) else []:
        is_found, at, covariance = _searched(corners, images[k], images[j], T_ok[j], model)
        fits = corners.narrow(is_found, at, T_ok[j], model)
        found.append((j, fits, at, covariance))
        count, spread = count + fits, spread + covariance * fits[:, None, None]
    kept = (count >= _SIGHTINGS - 1) & (corners.least > 0)  # otherwise it may be anywhere beyond
    number, T = np.cumsum(kept) - 1, poses[k]
    parts = [sightings(k, number[kept], uv[kept], spread[kept] / count[kept, None, None])]
    parts += [sightings(j, number[fits & kept], at[fits & kept], covariance[fits & kept]) for j, fits, at, covariance in found]
    points = corners.at(0.5).points.numpy()[kept] @ T[:3, :3].T + T[:3, 3]
    return points, joined(parts)


def _neighbours(k: int, T_ok: Array) -> list[int]:
    """The keyframes nearest to keyframe k that look the same way, at T_ok (K, 4, 4), the nearest first."""
    alike = np.rad2deg(np.arccos(T_ok[:, 2, 2].clip(-1, 1))) < _LOOK_ALIKE
    order = np.argsort(np.linalg.norm(T_ok[:, :3, 3], axis=1), kind="stable")
    return [int(j) for j in order if alike[j] and j != k][:_NEIGHBOURS]


def _searched(
    corners: _Rays, host: FrameFeatures, other: FrameFeatures, T_oh: Array, model: CameraModel
) -> tuple[NDArray[np.bool_], Array, Array]:
    """Which corners (N,) of a host another keyframe at T_oh (4, 4) shows, where, uv (N, 2), and the covariance (N, 2, 2) of that."""
    length = model.camera.fx * np.linalg.norm(T_oh[:3, 3]) * np.median(corners.most - corners.least)  # [px] of the interval, about
    tries = int(np.clip(np.ceil(length / _STEP), 1, _MOST_TRIES))
    best, uv, covariance = np.full(len(corners.uv), np.inf), np.zeros_like(corners.uv), np.zeros((len(corners.uv), 2, 2))
    for share in (np.arange(tries) + 0.5) / tries:
        at, there, spread = found_in(corners.at(float(share)), host, other, T_oh, model)
        size = np.trace(spread, axis1=1, axis2=2)
        better = size < best[at]
        best[at[better]], uv[at[better]], covariance[at[better]] = size[better], there[better], spread[better]
    return np.isfinite(best), uv, covariance
