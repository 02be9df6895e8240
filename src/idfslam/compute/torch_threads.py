"""The number of threads that torch uses in the commands that run SLAM."""

from typing import Literal


def limit_torch_threads(encoding: Literal["positional", "grid"]) -> None:
    """Gives torch one thread if the map's `encoding` is a grid. A program that calls `run` itself decides for itself.

    The grid's tensors are small, and compiled loops (Numba) use the other cores. Threads of torch that wait for each other would halve the
    frame rate.
    """
    if encoding == "grid":
        import torch

        torch.set_num_threads(1)
