"""How far a run has come, how fast it was and how much memory it took."""

import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from time import perf_counter
from typing import Any

import numpy as np
import torch

from idfslam.storage.state import State

_BLOCK = 100  # frames over which the course of the speed is given


class Meter:
    """Clock, counts and memory of a run; starts when it is made, which is after all imports."""

    def __init__(self) -> None:
        self.baseline = peak_memory()
        if torch.cuda.is_available():
            torch.cuda.reset_peak_memory_stats()
        self._start = perf_counter()
        self._stamps: list[float] = []  # [s] since the start, at the end of each frame
        self._unreadable = 0
        self._resumed_at: list[int] = []  # frames that were done each time the run was gone on with

    def state(self) -> State:
        """Times and counts; memory is each process' own."""
        return {"stamps": self._stamps, "unreadable": self._unreadable, "resumed_at": self._resumed_at}

    def restore(self, state: State) -> None:
        """What `state` told. The clock goes on from its last frame, so that what was done since this meter was made counts as well."""
        self._stamps, self._unreadable = state["stamps"], state["unreadable"]
        self._resumed_at = [*state["resumed_at"], len(self._stamps)]
        self._start -= self._stamps[-1]

    def frame(self, *, readable: bool = True) -> float:
        """One more frame is done; the milliseconds since the one before."""
        before = self._stamps[-1] if self._stamps else 0.0
        self._stamps.append(perf_counter() - self._start)
        self._unreadable += not readable
        return (self._stamps[-1] - before) * 1e3

    @property
    def frames(self) -> int:
        """How many are done."""
        return len(self._stamps)

    @property
    def frames_per_second(self) -> float:
        """Over the last frames, at most 20 of them."""
        last = self._stamps[-21:]
        return (len(last) - 1) / (last[-1] - last[0]) if len(last) > 1 else 1 / self._stamps[-1] if last else 0.0

    def summary(self, timings: Mapping[str, Sequence[float]]) -> dict[str, Any]:
        """Speed with everything up to now (also the final refinement), ms a frame by stage (`timings` in ms a call), peak memory."""
        frames, seconds = len(self._stamps), perf_counter() - self._start
        peak = peak_memory()
        summary = {
            "frames": frames,
            "seconds": seconds,
            "frames_per_second": frames / seconds,
            "frames_per_second_by_100": speed_by_block(self._stamps),
            "unreadable_frames": self._unreadable,
            "resumed_at": self._resumed_at,
            "ms_per_frame": {stage: float(np.sum(ms)) / max(frames, 1) for stage, ms in timings.items()},
            "peak_memory_mb": peak,
            "peak_memory_above_imports_mb": peak - self.baseline,
        }
        if torch.cuda.is_available():
            summary["peak_gpu_memory_mb"] = torch.cuda.max_memory_allocated() / 2**20
        return summary


def speed_by_block(stamps: Sequence[float], *, block: int = _BLOCK) -> list[float]:
    """Frames a second of each `block` frames in turn (the last may be shorter), from the times [s] at which frames ended."""
    edges = [0.0, *stamps[block - 1 :: block]]
    speeds = [block / (after - before) for before, after in pairwise(edges)]
    rest = len(stamps) % block
    return [*speeds, rest / (stamps[-1] - edges[-1])] if rest else speeds


def peak_memory() -> float:
    """The most memory [MiB] that this process has held so far; NaN where the system does not tell (Windows)."""
    if sys.platform == "win32":
        return float("nan")
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
