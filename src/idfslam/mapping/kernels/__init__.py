"""Kernels of the grid encoding: one contract, implemented in plain torch, Numba and Triton."""

from idfslam.mapping.kernels.grid import grid_encode, grid_scatter, load, sparse_adam
from idfslam.mapping.kernels.torch_grid import touched_runs

__all__ = ["grid_encode", "grid_scatter", "load", "sparse_adam", "touched_runs"]
