"""Kernels of fusion, compiled by Numba for the CPU."""
