"""One piece of work at a time beside the rest of the program: the map learns on one core while frames are tracked on another."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from time import perf_counter

from idfslam.compute.devices import threads
from idfslam.storage.state import State

Losses = dict[str, float]


def loops_may_overlap() -> bool:
    """Whether two threads may run parallel loops at once: Numba's own layer, without OpenMP and TBB, ends the program then."""
    import numba

    try:
        return bool(numba.threading_layer() != "workqueue")
    except ValueError:  # no loop has run yet
        return True


class Beside:
    """Runs functions in one thread of its own, each after the one before."""

    def __init__(self) -> None:
        self._milliseconds: list[float] = []  # that each took
        self._losses: Losses = {}  # of the last that ended, until they are told
        self._pool: ThreadPoolExecutor | None = None
        self._running: Future[Losses] | None = None

    def start(self, work: Callable[[], Losses]) -> None:
        """Begins with it, after the one that may still be running."""
        self.wait()
        if not loops_may_overlap():
            self._losses = self._timed(work)  # to the same result, only later
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, thread_name_prefix="map")
        self._running = self._pool.submit(self._timed, work)

    def wait(self) -> None:
        """Until what was started last has ended. Raises what it raised."""
        if self._running is not None:
            running, self._running = self._running, None
            self._losses = running.result()

    def losses(self) -> Losses:
        """Waits; the losses of what was started last, to whoever asks first."""
        self.wait()
        told, self._losses = self._losses, {}
        return told

    def times(self) -> list[float]:
        """The milliseconds that each took which has ended since the last call."""
        taken, self._milliseconds = self._milliseconds, []
        return taken

    def state(self) -> State:
        """The losses that nobody has been told yet."""
        self.wait()
        return {"losses": self._losses}

    def restore(self, state: State) -> None:
        """What `state` told."""
        self._losses = dict(state["losses"])

    def _timed(self, work: Callable[[], Losses]) -> Losses:
        start = perf_counter()
        with threads(0.5):
            losses = work()
        self._milliseconds.append((perf_counter() - start) * 1e3)
        return losses
