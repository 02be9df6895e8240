"""The choice between compiled loops and plain Python, as `compute/backend.py` makes it. Coarse views are on the host."""

from typing import Any

import torch

from idfslam.compute.backend import Backend, backend_of

_HOST = torch.device("cpu")


def compiles() -> bool:
    """Whether compiled loops are used."""
    return backend_of(_HOST) is Backend.NUMBA


def form(kernel: Any) -> Any:
    """A compiled loop that calls no other, or the Python that it was compiled from."""
    return kernel if compiles() else kernel.py_func
