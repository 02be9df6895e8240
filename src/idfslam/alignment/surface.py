"""The points of a frame that are aligned to the map: one of each patch of its depth image."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from idfslam.compute.backend import pick
from idfslam.geometry.camera import Camera
from idfslam.sensing.depth_noise import noise_ratio

_NO_WEIGHT = 1e3  # [1] noise of a point that does not count. More: nothing; its weight is a millionth of any other's


@dataclass(frozen=True)
class Surface:
    """N points of a frame, in the camera's frame."""

    points: Tensor  # (N, 3) [m]
    sigma: Tensor  # (N,) noise of the depth, relative to the sensor's best [1]
    rows: Tensor  # (N,) rows of the image, from -0.5 to 0.5
    patches: Tensor  # (rows, columns) int32: index of the point in each patch of the image, -1 for a patch without a point

    def every(self, step: int) -> "Surface":
        """Every `step`-th point."""
        kept = (self.patches >= 0) & (self.patches % step == 0)
        patches = torch.where(kept, self.patches // step, -1)
        points, sigma, rows = (values[::step].contiguous() for values in (self.points, self.sigma, self.rows))
        return Surface(points, sigma, rows, patches)

    def where(self, counts: Tensor) -> "Surface":
        """The same points, of which only some count (N,)."""
        return replace(self, sigma=self.sigma.where(counts, self.sigma.new_tensor(_NO_WEIGHT)))


def surface_points(depth: Tensor, camera: Camera, jitter: Tensor, patch: int) -> Surface:
    """One pixel of each patch of `patch` x `patch` pixels of a depth image (H, W) [m], if it has depth.

    jitter (2, rows, columns): row and column of the pixel within its patch.
    """
    return pick(depth, compiled=compiled_surface, plain=plain_surface)(depth, camera, jitter, patch)


def plain_surface(depth: Tensor, camera: Camera, jitter: Tensor, patch: int) -> Surface:
    """`surface_points` in torch, on any device."""
    rows, columns = jitter.shape[1:]
    v = (torch.arange(rows)[:, None] * patch + jitter[0]).flatten().to(depth.device)
    u = (torch.arange(columns)[None] * patch + jitter[1]).flatten().to(depth.device)
    z = depth[v, u]
    keep = z > 0
    patches = torch.where(keep, keep.cumsum(0) - 1, -1).int().view(rows, columns)
    v, u, z = v[keep], u[keep], z[keep]
    points = camera.rays(torch.stack([u, v], -1).to(z.dtype)) * z[:, None]
    return Surface(points, noise_ratio(z), (v + 0.5) / depth.shape[0] - 0.5, patches)


def compiled_surface(depth: Tensor, camera: Camera, jitter: Tensor, patch: int) -> Surface:
    """`surface_points` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_depth

    rows, columns = jitter.shape[1:]
    points, sigma, row_of = (np.empty(shape, np.float32) for shape in ((rows * columns, 3), rows * columns, rows * columns))
    patches = np.empty((rows, columns), np.int32)
    intrinsics = [np.float32(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy)]
    outputs = points, sigma, row_of, patches
    count = numba_depth.patch_points(depth.numpy(), jitter.numpy(), patch, *intrinsics, *outputs)  # type: ignore[call-arg]
    return Surface(*(torch.from_numpy(values) for values in (points[:count], sigma[:count], row_of[:count], patches)))
