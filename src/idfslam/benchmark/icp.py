"""Point-to-plane ICP and Generalized ICP of two depth images, by small_gicp: registration without any features."""

from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from idfslam.errors import ConfigError, pip_install
from idfslam.frame import Frame

Variant = Literal["PLANE_ICP", "GICP"]

_VOXEL = 0.04  # [m] points are reduced to one per voxel; larger: faster, less accurate
_REACH = 0.3  # [m] largest distance between corresponding points; larger: wider convergence, more wrong pairs
_ITERATIONS = 50  # at most


def icp_installed() -> bool:
    """Whether small_gicp is installed."""
    return find_spec("small_gicp") is not None


@dataclass(frozen=True, eq=False)
class Cloud:
    """A frame's points with normals and covariances, and their search tree."""

    points: Any
    tree: Any


class IterativeClosestPoints:
    """Aligns clouds, starting at the identity. Raises ConfigError if small_gicp is not installed."""

    def __init__(self, variant: Variant) -> None:
        if not icp_installed():
            raise ConfigError(f"ICP needs small_gicp, which is not installed: {pip_install('small_gicp')}")
        self._variant = variant

    def cloud(self, frame: Frame) -> Cloud:
        """The frame's depth as a cloud, on one thread."""
        import small_gicp
        import torch

        points = frame.camera.backproject(torch.from_numpy(frame.depth))[frame.depth > 0].double().numpy()
        return Cloud(*small_gicp.preprocess_points(points, downsampling_resolution=_VOXEL, num_threads=1))

    def align(self, source: Cloud, target: Cloud) -> tuple[NDArray[np.float64], bool]:
        """T_target_source (4, 4), and whether the iteration converged; the identity for an empty cloud."""
        import small_gicp

        if min(source.points.size(), target.points.size()) < 10:
            return np.eye(4), False
        options = {"max_correspondence_distance": _REACH, "num_threads": 1, "max_iterations": _ITERATIONS}
        found = small_gicp.align(target.points, source.points, target.tree, np.eye(4), registration_type=self._variant, **options)
        return np.asarray(found.T_target_source), bool(found.converged)
