"""The multi-resolution feature grid on unbounded space, as an encoding with its own gradient buffer."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from idfslam.compute.backend import Backend, backend_of
from idfslam.config import FieldConfig
from idfslam.mapping.kernels import grid_encode, grid_scatter, touched_runs


class GridEncoding(nn.Module):
    """Spatially hashed lattices of features with trilinear interpolation. It has `forward` and `out_dim` like every encoding.

    Space is unbounded: any lattice coordinate is hashed. A table that fills up is doubled by repeating it (`double_tables`). The encoding
    stays exactly the same, since the hash is taken modulo a power of two.
    """

    cells: Tensor  # (levels,) edges of the cells [m]
    gradient: Tensor  # (levels, entries, features) of the tables
    touched: Tensor  # marks of the runs of entries whose gradient may differ from zero (`touched_runs`)

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
            self.touched.fill_(1)  # the backward pass of autograd sets no marks
        features = grid_encode(points.reshape(-1, 3), self.tables, self.cells, accumulate_into=self.gradient)
        return features.reshape(*points.shape[:-1], self.out_dim)

    def add_gradient(self, points: Tensor, g_features: Tensor) -> None:
        """Adds the gradient by the features (N, levels * features) at points (N, 3) to the tables' gradient, without autograd."""
        grid_scatter(points, self.cells, g_features, self.gradient, touched=self.touched)

    def double_tables(self) -> None:
        """Doubles the number of entries. The encoding stays the same."""
        self.replace(torch.cat([self.tables.detach(), self.tables.detach()], 1))

    def replace(self, tables: Tensor) -> None:
        """Replaces the tables by copies of others, of any size."""
        device = self.tables.device
        self.tables = nn.Parameter(roomy_zeros(tables.shape, device).copy_(tables), requires_grad=self.tables.requires_grad)
        self.gradient, self.touched = roomy_zeros(tables.shape, device), touched_runs(self.tables)


def roomy_zeros(shape: Sequence[int], device: torch.device) -> Tensor:
    """Zeros on huge pages if the system has them, and not in memory until they are used. numpy requests such pages, torch does not.

    Hashed vertices lie anywhere in a table. With pages of 4 kB most of the time goes into address translation: a step on tables of 2^18
    entries takes 5.1 ms with them, and 4.2 ms with huge pages.
    """
    if backend_of(device) is not Backend.NUMBA:
        return torch.zeros(*shape, device=device)
    return torch.from_numpy(np.zeros(tuple(shape), np.float32))
