"""The colours of places from the images that see them: a weighted mean of those whose rays are nearest to the view's."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.compute.backend import pick
from idfslam.geometry.camera import Camera
from idfslam.geometry.projection import intrinsics_of
from idfslam.sensing.depth_edges import EDGE, EDGE_SHARE
from idfslam.views.constants import AGREES, AGREES_SHARE, ANGLE, BORDER, COARSE, LEAST_OFF_EDGE, NEAREST, NEGLIGIBLE, OFF_EDGE, UNREAD

Floats = NDArray[np.float32]

_FILLED = 0.99  # [1] share of the pixels of colour at a pixel of depth that must be filled. Less: black borders show. Chosen by hand


@dataclass(frozen=True, eq=False)
class BlendedImages:
    """K images as they are blended."""

    camera: Camera  # of colour
    colours: NDArray[np.uint8]  # (K, H, W, 3)
    depths: Floats  # (K, h, w) [m], 0: no reading
    off_edges: Floats  # (K, h, w) weights by the distance to silhouettes (`off_edge`)
    T_kw: Floats  # (K, 3, 4) from the world to each camera
    centres: Floats  # (K, 3) [m] of the cameras in the world
    base: Floats  # (K,) weights of the images
    gains: Floats  # (K, 3), and
    offsets: Floats  # (K, 3): gains * colour + offsets has the exposure of the view


def blended(points: Floats, centre: Floats, images: BlendedImages) -> tuple[Floats, Floats]:
    """Colours (N, 3) of points (N, 3) [m] in the world, seen from `centre` (3,), and their weights (N,): 0 where no image sees one.

    A point that is not finite has the weight 0.
    """
    return pick(torch.empty(0), compiled=compiled_blended, plain=plain_blended)(points, centre, images)


def compiled_blended(points: Floats, centre: Floats, images: BlendedImages) -> tuple[Floats, Floats]:
    """`blended`, compiled by Numba."""
    from idfslam.views.kernels import numba_views

    colour, weights = np.zeros((len(points), 3), np.float32), np.empty(len(points), np.float32)
    intrinsics = np.array(intrinsics_of(images.camera), np.float32)
    shown = images.colours, images.depths, images.off_edges, intrinsics, images.T_kw, images.centres
    numba_views.blend(points, centre, *shown, images.base, images.gains, images.offsets, colour, weights)
    return colour, weights


def plain_blended(points: Floats, centre: Floats, images: BlendedImages) -> tuple[Floats, Floats]:
    """`blended` in numpy."""
    finite = np.asarray(np.isfinite(points).all(axis=-1))
    colour, total = np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
    for k in range(len(images.colours)):
        most, weight, of_image = _of_image(np.where(finite[:, None], points, 0), centre, images, k)
        weight = np.where(finite & (most > NEGLIGIBLE * total), weight, 0)
        colour += weight[:, None] * (of_image * images.gains[k] + images.offsets[k])
        total += weight
    return np.where(total[:, None] > 0, colour / np.maximum(total, 1e-30)[:, None], 0).astype(np.float32), total


def _of_image(points: Floats, centre: Floats, images: BlendedImages, k: int) -> tuple[Floats, Floats, Floats]:
    """The weights (N,) of the k-th image at points (N, 3) if it saw them well, as it sees them, and its colours (N, 3) there."""
    weight, colour = seen_in_image(points, images.T_kw[k], images.camera, images.colours[k], images.depths[k], images.off_edges[k], UNREAD)
    to_view, to_image = points - centre, points - images.centres[k]
    from_view, from_image = np.linalg.norm(to_view, axis=1), np.linalg.norm(to_image, axis=1)
    cosine = (to_view * to_image).sum(1) / (from_view * from_image)
    angle = np.sqrt(np.maximum(0, 2 * (1 - cosine))) + COARSE * np.maximum(0, 1 - from_view / from_image)
    most = (images.base[k] * np.exp(-angle / ANGLE)).astype(np.float32)
    return most, weight * most, colour


def seen_in_image(
    points: Floats, T_cw: Floats, camera: Camera, colour: NDArray[np.uint8], depth: Floats, off_edges: Floats, unread: float
) -> tuple[Floats, Floats]:
    """How well an image sees points (N, 3), as a weight (N,), and its colours (N, 3) there, of 255, in numpy.

    T_cw (3, 4): its pose. depth, off_edges (h, w): see `BlendedImages`. unread: the weight where it has no depth.
    """
    uv, z = (part.numpy() for part in camera.project(torch.from_numpy(points @ T_cw[:, :3].T + T_cw[:, 3])))
    border = np.minimum(np.minimum(uv[:, 0], camera.width - 1 - uv[:, 0]), np.minimum(uv[:, 1], camera.height - 1 - uv[:, 1]))
    shown = (z >= NEAREST) & (border >= 0)
    u, v = (np.where(shown, part, 0) for part in uv.T)
    h, w = depth.shape
    column = np.minimum(((u + 0.5) * w / camera.width).astype(int), w - 1)
    row = np.minimum(((v + 0.5) * h / camera.height).astype(int), h - 1)
    around = np.pad(depth, 1)
    near = np.stack([around[row + 1 + i, column + 1 + j] for i in (-1, 0, 1) for j in (-1, 0, 1)])
    off = np.where(near > 0, np.abs(near - z), np.inf).min(0)
    weight = np.where(np.isinf(off), unread, off < AGREES + AGREES_SHARE * z**2) * off_edges[row, column]
    weight = weight * np.minimum(1, (border + 1) / BORDER) * (shown & (depth[row, column] >= 0))
    column, row = u.astype(int), v.astype(int)
    right, below = np.minimum(column + 1, camera.width - 1), np.minimum(row + 1, camera.height - 1)
    a, b = (u - column)[:, None], (v - row)[:, None]
    top, bottom = (colour[at, column] * (1 - a) + colour[at, right] * a for at in (row, below))
    return weight.astype(np.float32), (top * (1 - b) + bottom * b).astype(np.float32)


def off_edge(depth: Floats, lit: NDArray[np.bool_] | None = None) -> Floats:
    """The weight (h, w) of each pixel of a depth image (h, w) [m] by its distance from silhouettes, in [LEAST_OFF_EDGE, 1].

    lit (H, W): the pixels of colour that the camera fills; others have the weight 0. None: all are.
    """
    window = np.ones((3, 3), np.uint8)
    depth = np.maximum(depth, 0)
    farthest, nearest = cv2.dilate(depth, window), cv2.erode(np.where(depth > 0, depth, np.float32(np.inf)), window)
    edge = farthest - nearest > EDGE + EDGE_SHARE * nearest
    distance = cv2.distanceTransform((~edge).astype(np.uint8), cv2.DIST_L2, 3) if edge.any() else np.full(depth.shape, np.inf)
    weight = np.clip(LEAST_OFF_EDGE + distance / OFF_EDGE, 0, 1).astype(np.float32)
    if lit is None or lit.all():
        return weight
    filled = cv2.resize(lit.astype(np.float32), depth.shape[::-1], interpolation=cv2.INTER_AREA) > _FILLED
    faded = cv2.distanceTransform(np.pad(filled, 1).astype(np.uint8), cv2.DIST_L2, 3)[1:-1, 1:-1] * lit.shape[1] / depth.shape[1] / BORDER
    return np.asarray(weight * np.minimum(faded, 1), np.float32)
