"""The surface of a map: one signed distance, fused where depth images saw the surface well, the network's where they did not."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.fusion.tsdf_volume import TsdfVolume
from idfslam.mapping import compiled_field, sphere_tracing
from idfslam.mapping.sphere_tracing import Trace
from idfslam.mapping.surface_field import SurfaceField


@dataclass(frozen=True, eq=False)
class ImplicitSurface:
    """The signed distance of a field and of a volume of fused depth images, blended by the trust of each voxel."""

    field: SurfaceField
    volume: TsdfVolume | None = None  # None: the field alone

    @property
    def truncation(self) -> float:
        """tr [m], the unit of `sdf`."""
        return self.field.config.truncation

    @torch.no_grad()
    def sdf(self, points: Tensor) -> Tensor:
        """Signed distance (N,) [tr] at points (N, 3) [m], positive in front of the surface; without gradients."""
        of_field = self.of_field(points)
        if self.volume is None:
            return of_field
        distance = (of_field * self.truncation).float().cpu().numpy()
        return torch.from_numpy(self.volume.blend(points.float().cpu().numpy(), distance)).to(points.device) / self.truncation

    @torch.no_grad()
    def of_field(self, points: Tensor) -> Tensor:
        """The field's own signed distance (N,) [tr] at points (N, 3) [m]."""
        return compiled_field.sdf_function(self.field)(points)

    def refined(self, origins: NDArray[np.int64], cells: float, of_field: NDArray[np.float32]) -> NDArray[np.float32]:
        """The signed distance (B, S, S, S) [tr] at the points (origins + (i, j, k)) * cells [m] of B lattices, from the field's own."""
        if self.volume is None:
            return of_field
        tr = np.float32(self.truncation)
        return self.volume.blend_lattices(origins, cells, of_field * tr) / tr

    def tracer(self) -> Trace:
        """`sphere_tracing.trace` through this surface, compiled if possible."""
        if compiled_field.compilable(self.field):
            return partial(compiled_field.trace, self.field, volume=self.volume)
        return partial(sphere_tracing.trace, self.sdf)
