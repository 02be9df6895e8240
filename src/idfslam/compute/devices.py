"""Torch's devices, arithmetic, random numbers and threads."""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Literal

import torch

from idfslam.errors import ConfigError

KEPT_ON_CPU = ("fast",)
"""Presets that `auto` runs on the CPU: no run of them on a GPU was measured. One alignment makes 7 000 torch calls on the plain path."""


def resolve_device(name: Literal["auto", "cpu", "cuda"], preset: str | None = None) -> torch.device:
    """The device of a name. `auto` is a GPU if there is one, but the CPU for a run with a preset of `KEPT_ON_CPU`.

    preset: of the run; None for pretraining. Raises ConfigError if a GPU is named and there is none.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("--device cuda: this torch finds no CUDA device; use --device cpu, or install a CUDA build of torch")
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() and preset not in KEPT_ON_CPU else "cpu")
    return torch.device(name)


def bf16_pays(device: torch.device) -> bool:
    """Whether the device multiplies bf16 natively. It is then 2 to 12 times as fast as fp32 (docs/performance.md)."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return torch.cpu._is_amx_tile_supported() or torch.cpu._is_avx512_bf16_supported()


def resolve_precision(name: Literal["auto", "fp32", "bf16"], device: torch.device) -> torch.dtype:
    """The dtype of a name. `auto` is bf16 if the device multiplies it natively."""
    if name == "auto":
        return torch.bfloat16 if bf16_pays(device) else torch.float32
    return {"fp32": torch.float32, "bf16": torch.bfloat16}[name]


def updates_may_overlap(device: torch.device) -> bool:
    """Whether the map can learn in a second thread without slowing down the frames.

    It can with compiled kernels on the CPU. On CUDA both threads would wait on one stream, and for Python's interpreter between kernels.
    """
    return device.type == "cpu"


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """A context in which torch's global generator, which initialises networks, starts at `seed`. Afterwards its state is restored."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        yield


class _Repeating:
    """Counts the open `repeatable` contexts in all threads. Torch's setting is global, so only the last one to close restores it."""

    lock = Lock()
    count = 0
    before = 0  # the setting outside of `repeatable`


@contextmanager
def repeatable(device: torch.device) -> Iterator[None]:
    """A context in which gradients on the CPU are summed in a fixed order. Otherwise torch's threads add those of indexed tensors in any.

    The number of torch's threads is not only torch's setting: Numba and torch share OpenMP's.
    """
    if device.type != "cpu":
        yield
        return
    with _Repeating.lock:
        if _Repeating.count == 0:
            _Repeating.before = torch.get_deterministic_debug_mode()
            torch.set_deterministic_debug_mode("warn")  # `use_deterministic_algorithms` does the same, and imports torch's compiler
        _Repeating.count += 1
    try:
        yield
    finally:
        with _Repeating.lock:
            _Repeating.count -= 1
            if _Repeating.count == 0:
                torch.set_deterministic_debug_mode(_Repeating.before)


@contextmanager
def threads(share: float) -> Iterator[None]:
    """A context in which this thread's compiled loops use a share of Numba's threads, so that concurrent loops share the cores."""
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(max(1, round(share * numba.config.NUMBA_NUM_THREADS)))  # type: ignore[attr-defined]
    try:
        yield
    finally:
        numba.set_num_threads(before)


def loops_may_overlap() -> bool:
    """Whether two threads may run parallel loops at once. Numba's own threading layer aborts then; those of OpenMP and TBB do not."""
    import numba

    numba.get_num_threads()  # before the first loop there is no layer yet, and this starts one
    return bool(numba.threading_layer() != "workqueue")
