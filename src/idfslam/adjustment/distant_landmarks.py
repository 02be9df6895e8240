"""Landmarks without depth: corners where the sensor has no reading, mostly since they are beyond its reach.

Their directions hold rotations where depth is scarce. How far away a corner is follows from the keyframes that see it, the nearest first
(`distant_corners.py`). Its patch is tried at several inverse depths of its interval, some pixels apart along the epipolar line.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.distant_corners import DistantCorners, open_pixels
from idfslam.adjustment.landmark_tracks import KeyframeView, found_in, sightings, with_readings
from idfslam.adjustment.observations import Array, Observations, joined, together
from idfslam.tracking.frame_features import FrameFeatures

# All of these were chosen by hand on rooms larger than a Kinect's reach.
_LOOK_ALIKE = 25.0  # [degrees] largest angle between two keyframes' views. More: longer tracks, slower
_NEIGHBOURS = 8  # most keyframes in which a corner is looked for. More: longer tracks, slower
_STEP = 4.0  # [px] along the epipolar line between two tries. More: faster, and patches converge less often
_MOST_TRIES = 10  # of a patch in one keyframe. More: slower, and corners of unknown depth are found farther away
_SIGHTINGS = 4  # least of a landmark, with its host's. More: fewer and surer landmarks


def distant_landmarks(
    views: Sequence[KeyframeView], images: Sequence[FrameFeatures], poses: Array, model: CameraModel
) -> tuple[Array, Observations]:
    """Landmarks (L, 3) [m] in the world that their hosts have no depth of, and where keyframes at poses T_wk (K, 4, 4) see them.

    images: `features_of` views and model.
    """
    points, seen = together([_hosted(k, DistantCorners.of(view, model), images, poses, model) for k, view in enumerate(views)])
    seen = with_readings(views, seen)
    clear = np.zeros(len(seen), bool)
    for k, view in enumerate(views):
        of_view = seen.keyframe == k
        u, v = np.rint(seen.uv[of_view]).astype(np.int64).T
        rows, columns = view.grey.shape
        clear[of_view] = open_pixels(view)[v.clip(0, rows - 1), u.clip(0, columns - 1)]
    return points, seen[clear | (seen.reading > 0)]  # at the edge of what has depth, two surfaces are in the patch


def _hosted(
    k: int, corners: DistantCorners, images: Sequence[FrameFeatures], poses: Array, model: CameraModel
) -> tuple[Array, Observations]:
    """The landmarks (L, 3) [m] of keyframe k's corners, and their sightings, without readings."""
    uv, T_ok = corners.uv, np.linalg.inv(poses) @ poses[k]
    count, spread = np.zeros(len(uv)), np.zeros((len(uv), 2, 2))
    found = []
    for j in _neighbours(k, T_ok) if len(uv) else []:
        is_found, at, covariance = searched(corners, images[k], images[j], T_ok[j], model)
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


def searched(
    corners: DistantCorners, host: FrameFeatures, other: FrameFeatures, T_oh: Array, model: CameraModel
) -> tuple[NDArray[np.bool_], Array, Array]:
    """Which corners (N,) of a host another keyframe at T_oh (4, 4) shows, where, uv (N, 2), and the covariance (N, 2, 2) of that."""
    length = model.camera.fx * np.linalg.norm(T_oh[:3, 3]) * np.median(corners.most - corners.least)  # [px] of the interval, about
    tries, count = int(np.clip(np.ceil(length / _STEP), 1, _MOST_TRIES)), len(corners)
    size, uv, covariance = np.full(tries * count, np.inf), np.zeros((tries * count, 2)), np.zeros((tries * count, 2, 2))
    at, there, spread = found_in(corners.at(*(np.arange(tries) + 0.5) / tries), host, other, T_oh, model)
    uv[at], covariance[at], size[at] = there, spread, np.trace(spread, axis1=1, axis2=2)
    best = size.reshape(tries, count).argmin(0) * count + np.arange(count)  # the try that is placed most exactly
    return np.isfinite(size[best]), uv[best], covariance[best]
