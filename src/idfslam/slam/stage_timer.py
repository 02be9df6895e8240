"""Timing of the stages of a frame."""

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

import torch

from idfslam.storage.state import State, Stateful


class StageTimer(Stateful):
    """The durations [ms] of all calls, by stage."""

    def __init__(self) -> None:
        self.milliseconds: dict[str, list[float]] = defaultdict(list)

    def state(self) -> State:
        """The times."""
        return {stage: torch.tensor(ms, dtype=torch.float64) for stage, ms in self.milliseconds.items()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.milliseconds = defaultdict(list, {stage: ms.tolist() for stage, ms in state.items()})

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """A context that times a stage."""
        start = perf_counter()
        yield
        self.milliseconds[name].append((perf_counter() - start) * 1e3)
