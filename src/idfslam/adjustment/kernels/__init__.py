"""Kernels of the adjustment, compiled by Numba for the CPU."""
