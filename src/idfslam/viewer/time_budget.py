"""A share of a run's time for work that may be left out."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter


class Budget:
    """Allows a piece of work as often as `share` of the time since the budget was made has room for it.

    The first piece is always allowed, and each one is expected to cost what the last one did: the more it grows, the rarer it becomes.
    """

    def __init__(self, share: float, clock: Callable[[], float] = perf_counter) -> None:
        self.share, self._clock = share, clock
        self._start = clock()
        self.spent = 0.0  # [s]
        self._last = 0.0  # [s] that the last piece cost

    def allows(self) -> bool:
        """Whether there is time for another piece."""
        return self.spent + self._last <= self.share * (self._clock() - self._start)

    @contextmanager
    def spending(self) -> Iterator[None]:
        """A piece of work, within."""
        start = self._clock()
        try:
            yield
        finally:
            self._last = self._clock() - start
            self.spent += self._last
