"""The depth at a point of an image from all readings around it, where they are one smooth surface.

A quadratic is fitted to the inverse of depth: that of a plane is linear over the image, and the noise of structured light and stereo is
alike in it. A plane alone would place corners of rooms and furniture wrongly, by more where they are farther away.
"""

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.sensing.depth_noise import BEST, noise_ratio

Array = NDArray[np.float64]

_REACH = 6  # [px] to each side, of the readings around a point: of a patch that is aligned, and a pixel more. Raised, noise is less,
#    and fewer points are far enough from edges
_LEAST_SHARE = 0.8  # [1] of the pixels around that have a reading; raised, fewer points near edges have depth. This and the rest: by hand
_ROUGHNESS = 0.01  # [1] largest RMS distance of the readings from the best plane, as a share of depth; raised, edges are averaged over
_BENT = 0.003  # [1] largest distance of the surface from that plane, as a share of depth; raised, sharper corners count, less exactly
_FLOOR = 5e-4  # [1] least standard deviation as a share of depth, for what readings beside each other share; raised, depth counts less


def local_depth(depth: NDArray[np.float32], uv: Array) -> tuple[Array, Array, Array]:
    """Depth (N,) [m] at pixels uv (N, 2) of an image (H, W) [m], its standard deviation (N,), and its slope (N, 2) [m/px].

    The slope is along rows and columns. They are 0, 1 and 0 where no smooth surface is.
    """
    if not len(uv):
        return np.zeros(0), np.ones(0), np.zeros((0, 2))
    height, width = depth.shape
    centre, offset = np.rint(uv).astype(np.int64), np.arange(-_REACH, _REACH + 1)
    columns, rows = np.broadcast_arrays(centre[:, 0, None, None] + offset, centre[:, 1, None, None] + offset[:, None])
    columns, rows = columns.reshape(len(uv), -1), rows.reshape(len(uv), -1)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    z = np.where(inside, depth[rows.clip(0, height - 1), columns.clip(0, width - 1)], 0).astype(np.float64)
    known, count = z > 0, (z > 0).sum(1)
    inverse = np.divide(1, z, out=np.zeros_like(z), where=known)
    x, y = (columns - uv[:, :1]) / _REACH, (rows - uv[:, 1:]) / _REACH
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1) * known[..., None]
    H, b = terms.transpose(0, 2, 1) @ terms + 1e-6 * np.eye(6), (terms.transpose(0, 2, 1) @ inverse[..., None])
    plane, H_inverse = np.linalg.solve(H[:, :3, :3], b[:, :3]), np.linalg.inv(H)
    quadratic = (H_inverse @ b)[..., 0]
    surface = quadratic[:, 0]
    found = (surface > 0) & (plane[:, 0, 0] > 0) & (count >= _LEAST_SHARE * known.shape[1])
    at = np.divide(1, surface, out=np.ones_like(surface), where=found)
    rough = np.sqrt((((terms[..., :3] @ plane)[..., 0] - inverse) ** 2).sum(1) / np.maximum(count, 1)) * at
    found &= (rough < _ROUGHNESS) & (np.abs(plane[:, 0, 0] * at - 1) < _BENT)
    noise = BEST * noise_ratio(torch.from_numpy(at)).numpy()
    sigma = np.where(found, np.sqrt(H_inverse[:, 0, 0]) * noise + _FLOOR * at, 1.0)
    slope = -(at**2)[:, None] * quadratic[:, 1:3] / _REACH  # of the inverse of depth
    return np.where(found, at, 0.0), sigma, np.where(found[:, None], slope, 0.0)
