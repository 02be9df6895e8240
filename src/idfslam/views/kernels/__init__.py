"""Kernels of views, compiled by Numba for the CPU."""
