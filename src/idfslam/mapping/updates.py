"""When the map learns: in turns with the frames, or in a background thread while the next frames are tracked."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from time import perf_counter

from idfslam.compute.devices import loops_may_overlap, threads
from idfslam.storage.state import State

LossValues = dict[str, float]

# [1] Share of the cores for the loops of an update beside the frames. More: updates end sooner, and the frames beside them are slower.
# With all of them a frame of redkitchen takes 53 instead of 49 ms on two cores.
BESIDE_FRAMES = 0.5


class MapUpdates(ABC):
    """Runs the updates of a map, one after the other."""

    in_background = False  # whether an update continues after `run` has returned

    @abstractmethod
    def run(self, update: Callable[[], LossValues], publish: Callable[[], None], cores: float = BESIDE_FRAMES) -> LossValues:
        """Runs an update, publishes the newest finished one, and returns the losses of that one.

        cores: share of them [1] for an update beside something else. No result depends on it.
        """

    @abstractmethod
    def wait(self) -> None:
        """Waits for the last update. Raises the exception that it raised."""

    @abstractmethod
    def losses(self) -> LossValues:
        """Waits for the last update and returns its losses once; empty if they were returned before."""

    @abstractmethod
    def times(self) -> list[float]:
        """The durations [ms] of the updates that have ended since the last call."""

    @abstractmethod
    def state(self) -> State: ...

    @abstractmethod
    def restore(self, state: State) -> None: ...


class InTurns(MapUpdates):
    """Each update ends before the next frame is tracked, as in the paper."""

    def run(self, update: Callable[[], LossValues], publish: Callable[[], None], cores: float = BESIDE_FRAMES) -> LossValues:
        losses = update()
        publish()
        return losses

    def wait(self) -> None: ...

    def losses(self) -> LossValues:
        return {}

    def times(self) -> list[float]:
        return []

    def state(self) -> State:
        return {}

    def restore(self, state: State) -> None: ...


class InBackground(MapUpdates):
    """Updates run in a thread of their own. A new update waits for the one before and publishes it.

    Compiled code releases the interpreter's lock, so that the frames that are tracked meanwhile go on. Their loops use all cores: an update
    is seldom running, and beside them it has half of the cores at most.
    """

    in_background = True

    def __init__(self) -> None:
        self._milliseconds: list[float] = []
        self._losses: LossValues = {}  # of the last update, until `losses` returns them
        self._pool: ThreadPoolExecutor | None = None
        self._running: Future[LossValues] | None = None

    def run(self, update: Callable[[], LossValues], publish: Callable[[], None], cores: float = BESIDE_FRAMES) -> LossValues:
        losses = self.losses()
        publish()
        if not loops_may_overlap():
            self._losses = self._timed(update, cores)  # in the foreground: the result is the same
            return losses
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, thread_name_prefix="map")
        self._running = self._pool.submit(self._timed, update, cores)
        return losses

    def wait(self) -> None:
        if self._running is not None:
            running, self._running = self._running, None
            self._losses = running.result()

    def losses(self) -> LossValues:
        self.wait()
        losses, self._losses = self._losses, {}
        return losses

    def times(self) -> list[float]:
        milliseconds, self._milliseconds = self._milliseconds, []
        return milliseconds

    def state(self) -> State:
        """The losses that were not returned yet."""
        self.wait()
        return {"losses": self._losses}

    def restore(self, state: State) -> None:
        self._losses = dict(state["losses"])

    def _timed(self, update: Callable[[], LossValues], cores: float) -> LossValues:
        start = perf_counter()
        with threads(cores):
            losses = update()
        self._milliseconds.append((perf_counter() - start) * 1e3)
        return losses
