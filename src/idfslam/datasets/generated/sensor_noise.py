"""The noise of a structured-light camera (Kinect), added to ideal images.

Axial noise after Nguyen et al., "Modeling Kinect sensor noise for improved 3D reconstruction and tracking" (3DIMPVT
2012): sigma(z) = 0.0012 + 0.0019 (z - 0.4)^2 [m]; disparity in eighths of a pixel with baseline 7.5 cm and focal length 580 px.
"""

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera

NEAREST, FARTHEST = 0.4, 4.5  # [m] range of readings; widened, more of the scene has depth
BASELINE_FOCAL = 0.075 * 580  # [m px] raised, depth has finer steps (Nguyen et al.)
_DISPARITY_STEP = 1 / 8  # [px] raised, depth has coarser steps (Nguyen et al.)
_LATERAL = 0.5  # [px] standard deviation of the pixel that a reading is taken from; raised, edges are more ragged. Chosen by hand
_EDGE = 0.05  # [1] relative depth step within 3 x 3 pixels that counts as an edge; raised, fewer readings are lost. Chosen by hand
_EDGE_LOSS = 0.6  # [1] share of readings lost at edges; raised, holes are larger. Chosen by hand
_GRAZING = (
    np.cos(np.deg2rad(82)),
    np.cos(np.deg2rad(72)),
)  # cosines of the angle to the normal: below
#    the first all readings are lost, above the second none; raised, fewer slanted surfaces have depth. Chosen by hand

GRAIN = 0.012  # [1] standard deviation of the grain of colour; raised, colour is noisier. Chosen by hand


def axial_sigma(z: NDArray[np.floating]) -> NDArray[np.floating]:
    """Standard deviation [m] of a reading at depth z [m]."""
    return 0.0012 + 0.0019 * (z - 0.4) ** 2


def quantise(z: NDArray[np.floating]) -> NDArray[np.floating]:
    """Depth z > 0 [m] rounded to whole steps of disparity."""
    return BASELINE_FOCAL / (np.maximum(np.round(BASELINE_FOCAL / z / _DISPARITY_STEP), 1) * _DISPARITY_STEP)


def noisy_depth(depth: NDArray[np.float32], normals: NDArray[np.float32], camera: Camera, rng: Generator) -> NDArray[np.float32]:
    """Depth (H, W) [m] with jitter, noise, quantisation and holes (0); `normals` (H, W, 3) in the camera's frame."""
    v, u = np.mgrid[: camera.height, : camera.width]
    rows = np.clip(np.rint(v + rng.normal(0, _LATERAL, v.shape)), 0, camera.height - 1).astype(np.intp)
    columns = np.clip(np.rint(u + rng.normal(0, _LATERAL, u.shape)), 0, camera.width - 1).astype(np.intp)
    z = depth[rows, columns].astype(np.float64)
    has_surface = z > 0
    z = np.where(has_surface, z, 1.0)
    z = quantise(np.maximum(z + axial_sigma(z) * rng.standard_normal(z.shape), 0.05))
    lost = ~has_surface | (z < NEAREST) | (z > FARTHEST) | (rng.random(z.shape) < _loss(depth, normals, camera))
    return np.where(lost, 0, z).astype(np.float32)


def _loss(depth: NDArray[np.float32], normals: NDArray[np.float32], camera: Camera) -> NDArray[np.float64]:
    """(H, W) probability that a reading is lost: at depth edges and at grazing angles."""
    kernel = np.ones((3, 3), np.uint8)
    step = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel)
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height)[:, None] - camera.cy) / camera.fy
    cosine = np.abs(normals[..., 0] * x + normals[..., 1] * y + normals[..., 2]) / np.sqrt(x * x + y * y + 1)
    grazing = np.clip((_GRAZING[1] - cosine) / (_GRAZING[1] - _GRAZING[0]), 0, 1)
    return np.maximum(grazing, np.where(step > _EDGE * depth, _EDGE_LOSS, 0.0))


def noisy_colour(colour: NDArray[np.float32], timestamp: float, rng: Generator, grain: float = GRAIN) -> NDArray[np.float32]:
    """Colour (H, W, 3) with grain of this standard deviation, slowly drifting exposure and white balance, in 256 steps.

    `timestamp` is in seconds.
    """
    exposure = 1 + 0.06 * np.sin(2 * np.pi * timestamp / 9.0)
    balance = 1 + 0.015 * np.sin(2 * np.pi * timestamp / 13.0) * np.array([1.0, 0.0, -1.0])
    grainy = colour * (exposure * balance) + grain * rng.standard_normal(colour.shape)
    return (np.rint(np.clip(grainy, 0, 1) * 255) / 255).astype(np.float32)
