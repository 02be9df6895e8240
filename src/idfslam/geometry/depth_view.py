"""A posed depth image, as coverage and meshing use it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera


@dataclass(frozen=True)
class DepthView:
    """A depth image with its camera and pose."""

    T_wc: NDArray[np.float64]  # (4, 4)
    depth: NDArray[np.float32]  # (H, W) [m], 0 = no reading
    camera: Camera

    def points(self) -> NDArray[np.float64]:
        """The points (N, 3) [m] in the world of its pixels with a reading."""
        v, u = np.nonzero(self.depth)
        z, c = self.depth[v, u].astype(np.float64), self.camera
        return np.stack([(u - c.cx) / c.fx * z, (v - c.cy) / c.fy * z, z], -1) @ self.T_wc[:3, :3].T + self.T_wc[:3, 3]


def reduced_view(T_wc: NDArray[np.float64], depth: NDArray[np.float32], camera: Camera, height: int) -> DepthView:
    """A view with a regular subset of the pixels of `depth` (H, W) [m], at least `height` rows of them."""
    step = max(1, camera.height // height)
    first = step // 2
    return DepthView(T_wc, np.ascontiguousarray(depth[first::step, first::step]), camera.every(step))
