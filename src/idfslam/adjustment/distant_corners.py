"""Corners of an image where the sensor has no reading, and how far away they are as far as other images tell.

Each image that shows a corner narrows an interval of its inverse depth, which moves its place linearly (Civera, Davison and Montiel, 2008).
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.landmark_tracks import KeyframeView
from idfslam.adjustment.observations import Array
from idfslam.adjustment.patch_search import Found
from idfslam.storage.state import State
from idfslam.tracking.patches import Patches

# All of these were chosen by hand on rooms larger than a Kinect's reach.
_CLEAR = 6  # [px] around a corner without any reading, what moves, or black: its patch and a pixel more. More: fewer, farther from edges
_CELLS = 15  # cells in a column of the image, each of which has at most one corner. More: more corners, slower
_WINDOW = 5  # [px] in which a corner is measured. More: larger corners, less exactly placed
_LEAST_CORNER = 0.01  # [1] least strength of a corner, as a share of the image's strongest. More: fewer corners, with more contrast
_NEAREST = 1.0  # [m] least depth of a corner. More: faster, and near holes in depth have no landmarks
_FARTHEST = 1000.0  # [m] at which a patch is tried instead of at infinity, which is the same in a room
_MARGIN = 1.5  # [px] by which a place in a keyframe of inexact pose may be off along the line. More: intervals stay wider
_KNOWN = 0.1  # [1] of the inverse depth: half of the interval of a corner whose distance is known. More: used sooner, and less exact
_ADJUSTED = 0.05  # [1] the same of one that was adjusted, at first. More: it holds poses less
_OFF_LINE = 4.0  # [px] the same beside the line. More: worse poses are mended, and more patches are found wrongly


def open_pixels(view: KeyframeView) -> NDArray[np.bool_]:
    """(H, W) the pixels of a view around which there is no reading, nothing that moves, and no border that an undistorted image has."""
    closed = (view.depth > 0) | (view.grey == 0)
    if view.moving is not None:
        closed |= view.moving
    size = 2 * _CLEAR + 1
    return np.asarray(cv2.dilate(closed.astype(np.uint8), np.ones((size, size), np.uint8), borderValue=1) == 0)


@dataclass
class DistantCorners:
    """N corners of a host, and the interval in which the inverse depth of each lies."""

    uv: Array  # (N, 2) [px]
    rays: Array  # (N, 3) with z = 1
    least: Array  # (N,) [1/m]
    most: Array  # (N,) [1/m]

    @classmethod
    def of(cls, view: KeyframeView, model: CameraModel) -> "DistantCorners":
        """Those of a view, of which nothing is known but that they are not very near."""
        uv = _best_of_cells(view)
        return cls(uv, model.rays(uv), np.zeros(len(uv)), np.full(len(uv), 1 / _NEAREST))

    @classmethod
    def adjusted(cls, uv: Array, depth: Array, model: CameraModel) -> "DistantCorners":
        """Corners at pixels uv (N, 2) whose depth (N,) [m] an adjustment has found."""
        return cls(uv, model.rays(uv), (1 - _ADJUSTED) / depth, (1 + _ADJUSTED) / depth)

    def __add__(self, other: "DistantCorners") -> "DistantCorners":
        return DistantCorners(**{name: np.concatenate([array, vars(other)[name]]) for name, array in vars(self).items()})

    def state(self) -> State:
        """All of it."""
        return {name: torch.from_numpy(array.copy()) for name, array in vars(self).items()}

    @staticmethod
    def from_state(state: State) -> "DistantCorners":
        """What `state` was made of."""
        return DistantCorners(**{name: tensor.numpy().copy() for name, tensor in state.items()})

    def __len__(self) -> int:
        return len(self.uv)

    def __getitem__(self, chosen: NDArray[np.generic]) -> "DistantCorners":
        return DistantCorners(self.uv[chosen], self.rays[chosen], self.least[chosen], self.most[chosen])

    @property
    def are_known(self) -> NDArray[np.bool_]:
        """(N,) whether the interval says how far away a corner is."""
        return np.asarray(self.most - self.least < _KNOWN * (self.most + self.least))

    def at(self, *shares: float) -> Patches:
        """Patches that face the camera, at these shares of the intervals: those of all corners at the first, then at the next."""
        inverse = np.maximum(self.least + np.array(shares)[:, None] * (self.most - self.least), 1 / _FARTHEST)
        normals = -self.rays / np.linalg.norm(self.rays, axis=1, keepdims=True)
        uv, points, normals = np.tile(self.uv, (len(shares), 1)), self.rays / inverse[..., None], np.tile(normals, (len(shares), 1))
        return Patches(*map(torch.from_numpy, (uv, points.reshape(-1, 3), normals)))

    def narrow(self, found: NDArray[np.bool_], uv: Array, T_oh: Array, model: CameraModel) -> NDArray[np.bool_]:
        """Narrows the intervals of corners that another image, at T_oh (4, 4), shows at pixels uv (N, 2). Which of these fit them."""
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

    def narrow_by(self, found: Found, T_oh: Array, model: CameraModel) -> NDArray[np.bool_]:
        """The same with what another image was found to show of them. Which of that fits."""
        if not len(found.patch):
            return np.zeros(0, bool)
        at, uv = np.zeros(len(self), bool), np.zeros((len(self), 2))
        at[found.patch], uv[found.patch] = True, found.uv
        return self.narrow(at, uv, T_oh, model)[found.patch]


def _best_of_cells(view: KeyframeView) -> Array:
    """(N, 2) [px] the best corner of each cell of a view, where it is open."""
    half = cv2.pyrDown(view.grey)
    strength = cv2.cornerMinEigenVal(half, _WINDOW)
    strongest = max(float(strength.max()), 1e-12)
    (rows, columns), cell = half.shape, max(half.shape[0] // _CELLS, 1)
    strength = strength * open_pixels(view)[::2, ::2][:rows, :columns]
    down, across = rows // cell, columns // cell
    cells = strength[: down * cell, : across * cell].reshape(down, cell, across, cell).transpose(0, 2, 1, 3).reshape(down * across, -1)
    best, number = cells.argmax(1), np.arange(len(cells))
    uv = 2.0 * np.stack([number % across * cell + best % cell, number // across * cell + best // cell], 1)
    return uv[cells.max(1) > _LEAST_CORNER * strongest]
