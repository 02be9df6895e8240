"""The depth of a view from the depth images around it: each is warped into the view, and what most agree on is taken."""

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.compute.backend import pick
from idfslam.geometry.camera import Camera
from idfslam.geometry.projection import intrinsics_of
from idfslam.sensing.depth_edges import EDGE, EDGE_SHARE
from idfslam.views.constants import NEAREST, SAME, SAME_SHARE

Floats = NDArray[np.float32]


def fused_depth(depths: Floats, of_depths: Camera, T_vk: Floats, view: Camera, weights: Floats) -> Floats:
    """Depth (H, W) [m] of a view, 0 where no image has any: K depth images (K, h, w) warped into it, and fused.

    T_vk (K, 3, 4): from the camera of each image to that of the view. weights (K,): of the images.
    """
    form = pick(torch.empty(0), compiled=compiled_fused_depth, plain=plain_fused_depth)
    return form(depths, of_depths, T_vk, view, weights)


def compiled_fused_depth(depths: Floats, of_depths: Camera, T_vk: Floats, view: Camera, weights: Floats) -> Floats:
    """`fused_depth`, compiled by Numba."""
    from idfslam.views.kernels import numba_views

    warped, depth = np.zeros((len(depths), view.height, view.width), np.float32), np.zeros((view.height, view.width), np.float32)
    of_images, of_view = (np.array(intrinsics_of(camera), np.float32) for camera in (of_depths, view))
    numba_views.warp(depths, of_images, T_vk, of_view, warped)
    numba_views.fuse(warped, weights, depth)
    return depth


def plain_fused_depth(depths: Floats, of_depths: Camera, T_vk: Floats, view: Camera, weights: Floats) -> Floats:
    """`fused_depth` in numpy, slow."""
    warped = np.stack([_warped(depth, of_depths, T, view) for depth, T in zip(depths, T_vk)])
    z, others = warped[:, None], warped[None]
    with np.errstate(divide="ignore", invalid="ignore"):
        off = (others - z) / (SAME + SAME_SHARE * z**2)
        share = np.where((z > 0) & (others > 0) & (np.abs(off) < 1), weights[None, :, None, None] * (1 - off**2), 0)
        score = np.where(warped > 0, share.sum(1) / warped, 0)
        mean = (share * others).sum(1) / share.sum(1)
    best = score.argmax(0)[None]
    return np.where(warped.any(0), np.take_along_axis(mean, best, 0)[0], 0).astype(np.float32)


def _warped(depth: Floats, camera: Camera, T: Floats, view: Camera) -> Floats:
    """The nearest depth (H, W) of the triangles between a depth image's readings, seen from the view; triangle after triangle."""
    points = camera.backproject(torch.from_numpy(depth)).numpy() @ T[:, :3].T + T[:, 3]
    z = np.where((depth > 0) & (points[..., 2] >= NEAREST), points[..., 2], 0)
    safe = np.where(z > 0, z, 1)
    x, y = points[..., 0] / safe * view.fx + view.cx, points[..., 1] / safe * view.fy + view.cy
    number = np.arange(depth.size).reshape(depth.shape)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]))
    rows, columns = np.mgrid[0 : view.height, 0 : view.width]
    out = np.full((view.height, view.width), np.inf)
    for corners in np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]):
        (x0, x1, x2), (y0, y1, y2), q = x.flat[corners], y.flat[corners], z.flat[corners]
        read = depth.flat[corners]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if q.min() <= 0 or area <= 1e-6 or read.max() - read.min() > EDGE + EDGE_SHARE * read.min():
            continue
        b1 = ((columns - x0) * (y2 - y0) - (x2 - x0) * (rows - y0)) / area
        b2 = ((x1 - x0) * (rows - y0) - (columns - x0) * (y1 - y0)) / area
        inside = np.minimum(np.minimum(b1, b2), 1 - b1 - b2) >= -1e-4
        here = 1 / ((1 - b1 - b2) / q[0] + b1 / q[1] + b2 / q[2])
        out = np.where(inside, np.minimum(out, here), out)
    return np.where(np.isfinite(out), out, 0).astype(np.float32)
