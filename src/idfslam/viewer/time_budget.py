"""Limits optional work to a share of a run's time."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter


class Budget:
    """Allows a task as long as the time spent on it stays below `share` of the time since the budget was created.

    The first task is always allowed. Each task is expected to take as long as the one before, so a task that grows is allowed less often.
    """

    def __init__(self, share: float, clock: Callable[[], float] = perf_counter) -> None:
        self.share, self._clock = share, clock
        self._start = clock()
        self.spent = 0.0  # [s]
        self._last = 0.0  # [s] that the last task took

    def allows(self) -> bool:
        """Whether there is time for another task."""
        return self.spent + self._last <= self.share * (self._clock() - self._start)

    @contextmanager
    def spending(self) -> Iterator[None]:
        """Counts the time of the `with` block."""
        start = self._clock()
        try:
            yield
        finally:
            self._last = self._clock() - start
            self.spent += self._last
