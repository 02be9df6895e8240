"""When the map learns: in turns with the frames, or in the background on a core of its own while the next frames are tracked."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from time import perf_counter

from idfslam.compute.devices import threads
from idfslam.storage.state import State

Losses = dict[str, float]


class MapUpdates(ABC):
    """Runs the updates of a map, one after the other."""

    in_background = False  # whether an update goes on after `run` has returned
    foreground_share = 1.0  # of the cores, for what runs beside an update

    @abstractmethod
    def run(self, update: Callable[[], Losses], publish: Callable[[], None]) -> Losses:
        """Runs an update, and publishes the newest finished one; the losses of that."""

    @abstractmethod
    def wait(self) -> None:
        """Returns when the last update has ended. Raises what it raised."""

    @abstractmethod
    def losses(self) -> Losses:
        """Waits; the losses of the last update, to the first who asks."""

    @abstractmethod
    def times(self) -> list[float]:
        """How long each update took that has ended since the last call [ms]."""

    @abstractmethod
    def state(self) -> State: ...

    @abstractmethod
    def restore(self, state: State) -> None: ...

    def foreground(self) -> AbstractContextManager[None]:
        """Within, compiled loops take the share of the cores that updates leave them."""
        return threads(self.foreground_share)


class InTurns(MapUpdates):
    """Each update has ended before the next frame is tracked, as in the paper."""

    def run(self, update: Callable[[], Losses], publish: Callable[[], None]) -> Losses:
        with threads(1.0):
            losses = update()
        publish()
        return losses

    def wait(self) -> None: ...

    def losses(self) -> Losses:
        return {}

    def times(self) -> list[float]:
        return []

    def state(self) -> State:
        return {}

    def restore(self, state: State) -> None: ...


class InBackground(MapUpdates):
    """An update runs in a thread of its own; the one before is waited for and published when the next begins.

    Compiled code leaves the interpreter to other threads, so on two cores an update costs the frames beside it nothing.
    """

    in_background = True
    foreground_share = 0.5

    def __init__(self) -> None:
        self._milliseconds: list[float] = []
        self._losses: Losses = {}  # of the last update, until somebody asks
        self._pool: ThreadPoolExecutor | None = None
        self._running: Future[Losses] | None = None

    def run(self, update: Callable[[], Losses], publish: Callable[[], None]) -> Losses:
        losses = self.losses()
        publish()
        if not loops_may_overlap():
            self._losses = self._timed(update)  # the same result, only later
            return losses
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, thread_name_prefix="map")
        self._running = self._pool.submit(self._timed, update)
        return losses

    def wait(self) -> None:
        if self._running is not None:
            running, self._running = self._running, None
            self._losses = running.result()

    def losses(self) -> Losses:
        self.wait()
        losses, self._losses = self._losses, {}
        return losses

    def times(self) -> list[float]:
        taken, self._milliseconds = self._milliseconds, []
        return taken

    def state(self) -> State:
        """The losses that nobody has asked for yet."""
        self.wait()
        return {"losses": self._losses}

    def restore(self, state: State) -> None:
        self._losses = dict(state["losses"])

    def _timed(self, update: Callable[[], Losses]) -> Losses:
        start = perf_counter()
        with threads(0.5):
            losses = update()
        self._milliseconds.append((perf_counter() - start) * 1e3)
        return losses


def loops_may_overlap() -> bool:
    """Whether two threads may run parallel loops at once; Numba's own layer, without OpenMP and TBB, ends the program then."""
    import numba

    try:
        return bool(numba.threading_layer() != "workqueue")
    except ValueError:  # no loop has run yet
        return True
