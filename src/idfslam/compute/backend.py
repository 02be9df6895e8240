"""The choice of a backend: loops compiled by Numba on the CPU, Triton kernels on CUDA, plain torch on any device.

A computation with a compiled kernel has two forms: `plain_X` in torch, and `compiled_X` by Numba. `X` picks one of them by the device of
its tensors, and tests compare the two. A backend for another device is added here.
"""

import functools
import importlib.util
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum
from threading import Lock
from typing import Any, TypeVar

import torch
from torch import Tensor

log = logging.getLogger(__name__)

Function = TypeVar("Function", bound=Callable[..., Any])


class Backend(Enum):
    """What computes."""

    NUMBA = "numba"  # all kernels, compiled for the CPU
    TRITON = "triton"  # the kernels of the feature grid, compiled for CUDA; everything else is plain torch
    TORCH = "torch"  # no kernels: plain torch on any device


def backend_of(device: torch.device) -> Backend:
    """The backend for tensors on this device."""
    if _PlainTorch.count > 0:
        return Backend.TORCH
    if device.type == "cpu":
        return Backend.NUMBA
    return Backend.TRITON if device.type == "cuda" and _has_triton() else Backend.TORCH


def pick(tensor: Tensor, *, compiled: Function, plain: Function) -> Function:
    """The form of a computation for this tensor: the one compiled by Numba, or the plain one in torch."""
    return compiled if tensor.is_cpu and _PlainTorch.count == 0 else plain  # as `backend_of` says; a frame asks a hundred times


class _PlainTorch:
    """The number of open `plain_torch` contexts in all threads: the mapper's thread must compute as its caller's thread does."""

    lock = Lock()
    count = 0


@contextmanager
def plain_torch() -> Iterator[None]:
    """A context in which no thread of the process calls kernels: plain torch computes on every device. Slow; for tests and debugging."""
    with _PlainTorch.lock:
        _PlainTorch.count += 1
    try:
        yield
    finally:
        with _PlainTorch.lock:
            _PlainTorch.count -= 1


@functools.cache
def _has_triton() -> bool:
    """Whether Triton is installed. Logs a warning, once, if it is not."""
    installed = importlib.util.find_spec("triton") is not None
    if not installed:
        log.warning("the package triton is missing: on CUDA plain torch computes the feature grid, slower")
    return installed
