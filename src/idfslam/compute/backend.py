"""The one choice of who computes: loops compiled by Numba on the CPU, Triton kernels on CUDA, plain torch anywhere.

A computation that is worth a compiled kernel exists twice: `plain_X` in torch, `compiled_X` by Numba. `X` picks one of them by the device
of its tensors, and tests hold the two against each other. A backend for another device is added here.
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
    """Who computes."""

    NUMBA = "numba"  # every kernel, compiled for the CPU
    TRITON = "triton"  # the kernels of the feature grid, compiled for CUDA; all else is plain torch
    TORCH = "torch"  # no kernel: plain torch on any device


def backend_of(device: torch.device) -> Backend:
    """The backend for tensors on this device."""
    if _PlainTorch.count > 0:
        return Backend.TORCH
    if device.type == "cpu":
        return Backend.NUMBA
    return Backend.TRITON if device.type == "cuda" and _has_triton() else Backend.TORCH


def pick(tensor: Tensor, *, compiled: Function, plain: Function) -> Function:
    """Which of two forms of one computation is to be called for this tensor: the one compiled by Numba, or the one in torch."""
    return compiled if backend_of(tensor.device) is Backend.NUMBA else plain


class _PlainTorch:
    """How many `plain_torch` contexts are open, in all threads of the process: the mapper's thread has to compute as the caller's does."""

    lock = Lock()
    count = 0


@contextmanager
def plain_torch() -> Iterator[None]:
    """Within, no thread of this process calls a kernel: plain torch computes on every device. For tests and debugging, it is slow."""
    with _PlainTorch.lock:
        _PlainTorch.count += 1
    try:
        yield
    finally:
        with _PlainTorch.lock:
            _PlainTorch.count -= 1


@functools.cache
def _has_triton() -> bool:
    """Whether Triton is installed; a warning, once, if it is not."""
    found = importlib.util.find_spec("triton") is not None
    if not found:
        log.warning("the package triton is missing: on CUDA plain torch computes the feature grid, slower")
    return found
