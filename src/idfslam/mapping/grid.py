"""The multi-resolution feature grid on unbounded space, as an encoding and with its own optimiser state."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from idfslam.compute.backend import Backend, backend_of
from idfslam.config import FieldConfig
from idfslam.mapping.kernels import grid_encode, grid_scatter, touched_runs


class GridEncoding(nn.Module):
    """Spatially hashed lattices of features, trilinearly interpolated; `forward` and `out_dim` as any encoding.

    There are no bounds: a lattice coordinate is hashed wherever it lies. A table that fills up doubles by being
    written twice (`grow`), which leaves the function exactly as it was, since the hash is taken modulo a power of two.
    """

    cells: Tensor  # (levels,) edges [m]
    gradient: Tensor  # of the tables
    touched: Tensor  # where it may be other than zero

    def __init__(self, config: FieldConfig) -> None:
        super().__init__()
        ratio = (config.finest / config.coarsest) ** (1 / max(config.levels - 1, 1))
        self.register_buffer("cells", torch.tensor([config.coarsest * ratio**level for level in range(config.levels)]))
        tables = torch.empty(config.levels, 2**config.table_log2, config.features).uniform_(-1e-4, 1e-4)
        self.tables = nn.Parameter(roomy_zeros(tables.shape, tables.device).copy_(tables))
        self.register_buffer("gradient", roomy_zeros(tables.shape, tables.device), persistent=False)  # backward adds, Adam zeroes
        self.register_buffer("touched", touched_runs(self.tables), persistent=False)
        self.out_dim = config.levels * config.features

    def forward(self, points: Tensor) -> Tensor:
        """Points (..., 3) [m] -> (..., levels * features)."""
        if self.tables.requires_grad:
            self.touched.fill_(1)  # what comes back through autograd marks nothing
        features = grid_encode(points.reshape(-1, 3), self.tables, self.cells, accumulate_into=self.gradient)
        return features.reshape(*points.shape[:-1], self.out_dim)

    def add_gradient(self, points: Tensor, g_features: Tensor) -> None:
        """Add to the tables' gradient what (N, levels * features) means for them, without autograd."""
        grid_scatter(points, self.cells, g_features, self.gradient, touched=self.touched)

    def grow(self) -> None:
        """Twice the entries, the same function."""
        self.replace(torch.cat([self.tables.detach(), self.tables.detach()], 1))

    def replace(self, tables: Tensor) -> None:
        """Other tables, of any size; their values are copied."""
        device = self.tables.device
        self.tables = nn.Parameter(roomy_zeros(tables.shape, device).copy_(tables), requires_grad=self.tables.requires_grad)
        self.gradient, self.touched = roomy_zeros(tables.shape, device), touched_runs(self.tables)


def roomy_zeros(shape: Sequence[int], device: torch.device) -> Tensor:
    """Zeros on huge pages where the system has them, not touched until they are used: numpy asks for such pages, torch does not.

    Hashed vertices lie anywhere in a table, so that on pages of 4 kB most of the time goes into finding the pages (a step on tables of
    2^18 entries: 5.1 ms before, 4.2 after).
    """
    if backend_of(device) is not Backend.NUMBA:
        return torch.zeros(*shape, device=device)
    return torch.from_numpy(np.zeros(tuple(shape), np.float32))
