"""Measures the number of frames, the speed and the memory of a run."""

import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from time import perf_counter
from typing import Any

import numpy as np
import torch

from idfslam.storage.state import State

BLOCK = 100  # frames over which each value of the speed is a mean; more: smoother values, fewer of them


class Meter:
    """Clock, frame counts and peak memory of a run. The clock starts when the object is created; create it after all imports."""

    def __init__(self) -> None:
        self.baseline = peak_memory()
        if torch.cuda.is_available():
            torch.cuda.reset_peak_memory_stats()
        self._start = perf_counter()
        self._stamps: list[float] = []  # [s] since the start, at the end of each frame
        self._unreadable = 0
        self._resumed_at: list[int] = []  # frames done at each resumption

    def state(self) -> State:
        """Times and counts. Memory is not part of it: it belongs to the process."""
        return {"stamps": self._stamps, "unreadable": self._unreadable, "resumed_at": self._resumed_at}

    def restore(self, state: State) -> None:
        """Sets the state that `state` returned. The clock continues from its last frame; the time since this meter was created is added."""
        self._stamps, self._unreadable = state["stamps"], state["unreadable"]
        self._resumed_at = [*state["resumed_at"], len(self._stamps)]
        self._start -= self._stamps[-1]

    def frame(self, *, readable: bool = True) -> float:
        """Counts a frame that has just ended. Returns the milliseconds since the end of the previous one."""
        before = self._stamps[-1] if self._stamps else 0.0
        self._stamps.append(perf_counter() - self._start)
        self._unreadable += not readable
        return (self._stamps[-1] - before) * 1e3

    @property
    def frames(self) -> int:
        """Number of frames done."""
        return len(self._stamps)

    @property
    def frames_per_second(self) -> float:
        """Mean over the last 20 frames."""
        last = self._stamps[-21:]
        return (len(last) - 1) / (last[-1] - last[0]) if len(last) > 1 else 1 / self._stamps[-1] if last else 0.0

    def summary(self, timings: Mapping[str, Sequence[float]]) -> dict[str, Any]:
        """Speed up to now (including the final refinement), mean ms of each stage per frame, peak memory. timings: [ms] of each call."""
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


def speed_by_block(stamps: Sequence[float], *, block: int = BLOCK) -> list[float]:
    """Frames per second of each block of `block` frames (the last may be shorter). stamps: [s] at which each frame ended."""
    edges = [0.0, *stamps[block - 1 :: block]]
    speeds = [block / (after - before) for before, after in pairwise(edges)]
    rest = len(stamps) % block
    return [*speeds, rest / (stamps[-1] - edges[-1])] if rest else speeds


def peak_memory() -> float:
    """Peak memory [MiB] of this process so far; NaN on Windows, which does not report it."""
    if sys.platform == "win32":
        return float("nan")
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
