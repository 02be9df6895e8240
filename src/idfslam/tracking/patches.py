"""Small patches of a keyframe's image that later frames are compared with: corners on smooth surfaces, with their points and normals."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from idfslam.geometry.camera import Camera

# All of these were chosen by hand on pairs of frames.
_CELLS = 15  # cells in a column of the image, each of which has at most one patch. More: more patches, slower
_CORNER = 5  # [px] size of the window in which a corner is measured. More: larger corners, less exactly placed
_LEAST_CORNER = 1e-4  # [1] least strength of a corner, as a share of the image's strongest. More: fewer patches, with more contrast
_OFF_PLANE = 0.05  # [1] largest distance of a patch's point from the point of the features' pixel, as a share of its depth. More: slants
GRAZING = 1e-3  # [1] least cosine between a ray and its surface. More: fewer slanted patches


@dataclass(frozen=True)
class Patches:
    """N patches of a keyframe's `grey` image, in its camera's frame."""

    uv: Tensor  # (N, 2) float64, centres [px]
    points: Tensor  # (N, 3) float64 [m]
    normals: Tensor  # (N, 3) float64, towards the camera

    def __len__(self) -> int:
        return len(self.uv)

    def __getitem__(self, chosen: Tensor) -> "Patches":
        return Patches(self.uv[chosen], self.points[chosen], self.normals[chosen])

    def on_planes(self, camera: Camera, uv: Tensor) -> Tensor:
        """The points (N, 3) where the rays of pixels `uv` (N, 2) meet the patches' planes."""
        rays = camera.rays(uv)
        facing = (rays * self.normals).sum(-1).clamp(max=-GRAZING)
        return rays * ((self.points * self.normals).sum(-1) / facing)[:, None]


def chosen_patches(grey: Tensor, points: Tensor, normals: Tensor, camera: Camera) -> Patches:
    """The best corner of each cell of an image `grey` (H, W) of a camera, where the surface around it is smooth.

    points, normals (h, w, 3): of the same view, zero where there is none. An image smaller than a few pixels a cell has no patches.
    """
    if min(grey.shape) < 4 * _CELLS:
        return Patches(*(torch.zeros(0, n, dtype=torch.float64) for n in (2, 3, 3)))
    half = cv2.pyrDown(grey.numpy())
    (rows, columns), cell = half.shape, half.shape[0] // _CELLS
    smooth = cv2.resize((normals[..., 2] != 0).numpy().astype(np.float32), (columns, rows), interpolation=cv2.INTER_NEAREST)
    strength = cv2.cornerMinEigenVal(half, _CORNER) * smooth
    down, across = rows // cell, columns // cell
    cells = strength[: down * cell, : across * cell].reshape(down, cell, across, cell).transpose(0, 2, 1, 3).reshape(down * across, -1)
    best, index = cells.argmax(1), np.arange(len(cells))
    u, v = index % across * cell + best % cell, index // across * cell + best // cell
    strong = cells.max(1) > _LEAST_CORNER * max(float(cells.max()), 1e-12)
    return _on_surface(2 * torch.from_numpy(np.stack([u, v], 1)[strong]).double(), points, normals, camera)


def _on_surface(uv: Tensor, points: Tensor, normals: Tensor, camera: Camera) -> Patches:
    """The patches at `uv` (N, 2), with the planes of the surface there; without those where points and plane disagree."""
    height, width = normals.shape[:2]
    scale = torch.tensor([width / camera.width, height / camera.height])
    column, row = ((uv + 0.5) * scale - 0.5).round().long().clamp(min=0).minimum(torch.tensor([width - 1, height - 1])).unbind(-1)
    patches = Patches(uv, points[row, column].double(), normals[row, column].double())
    centres = patches.on_planes(camera, uv)
    near = (centres[:, 2] - patches.points[:, 2]).abs() < _OFF_PLANE * patches.points[:, 2]
    return Patches(uv, centres, patches.normals)[near]
