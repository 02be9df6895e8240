"""The number of threads that torch uses in the commands that run SLAM."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

_before = 1  # torch's threads before `limit_torch_threads`; 1: it was not called, and the program has decided for itself


def limit_torch_threads(encoding: Literal["positional", "grid"]) -> None:
    """Gives torch one thread if the map's `encoding` is a grid. A program that calls `run` itself decides for itself.

    The grid's tensors are small, and compiled loops (Numba) use the other cores. Threads of torch that wait for each other would halve the
    frame rate.
    """
    global _before
    if encoding == "grid":
        import torch

        _before = max(_before, torch.get_num_threads())
        torch.set_num_threads(1)


@contextmanager
def unlimited_torch_threads() -> Iterator[None]:
    """A context for large tensors, such as a convolution of an image: torch has the threads that it had before they were limited."""
    import torch

    now = torch.get_num_threads()
    torch.set_num_threads(max(now, _before))
    try:
        yield
    finally:
        torch.set_num_threads(now)
