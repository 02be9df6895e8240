"""What executes runs: the common part of processes on this machine (`local_executor`) and on a Ray cluster (`ray_executor`).

Every execution is a process of its own, so that memory and failures are those of one run. A process that is killed (out of memory,
a node that goes away) is started again; one that ends with an error has said why, and is not.
"""

import logging
import os
import platform
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from time import perf_counter
from types import TracebackType
from typing import TypeVar

from idfslam.compute.host import default_threads
from idfslam.errors import ConfigError

log = logging.getLogger(__name__)

Item = TypeVar("Item")
Result = TypeVar("Result")

THREAD_VARIABLES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class JobOutcome:
    """How a process ended."""

    error: str | None  # the last line that it had to say; None: it ended well
    seconds: float  # of the last attempt
    where: str  # the host
    attempts: int = 1


class Crash(Exception):
    """A process that was killed, or whose node went away: another attempt may do."""


class Executor(ABC):
    """Executes modules of the package, `workers` of them at once; to be used in a `with`, at whose end nothing is left running."""

    def __init__(self, workers: int, *, retries: int = 0) -> None:
        """`retries`: how often a process that was killed is started again."""
        if workers < 1:
            raise ConfigError(f"--workers {workers}, expected at least 1")
        self.workers, self.retries = workers, retries
        self._stopped = threading.Event()

    @abstractmethod
    def _attempt(self, module: str, arguments: tuple[str, ...]) -> tuple[str | None, str]:
        """The error, if any, and the host. Raises Crash where the process was killed."""

    def execute(self, module: str, *arguments: str) -> JobOutcome:
        """`python -m MODULE ARGUMENTS`, waited for; may be called from several threads at once."""
        error: str | None = INTERRUPTED
        where, seconds, attempt = platform.node(), 0.0, 0
        while attempt <= self.retries and not self._stopped.is_set():
            attempt += 1
            start = perf_counter()
            try:
                error, where = self._attempt(module, arguments)
            except Crash as crash:
                error, seconds = str(crash), perf_counter() - start
                log.warning("%s (attempt %d of %d): %s", error, attempt, self.retries + 1, " ".join(arguments[:2]))
                continue
            return JobOutcome(error, perf_counter() - start, where, attempt)
        return JobOutcome(error, seconds, where, attempt)

    def each(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """`function` of each item, `workers` at once, in the order in which they end. On Ctrl-C what has not begun is not begun."""
        with ThreadPoolExecutor(self.workers) as pool:
            futures = [pool.submit(function, item) for item in items]
            try:
                for future in as_completed(futures):
                    yield future.result()
            except BaseException:
                self.stop()
                raise

    def stop(self) -> None:
        """No process is started any more; those that run get the terminal's Ctrl-C too and end with their results so far."""
        self._stopped.set()

    def close(self) -> None:
        """Nothing is left running."""
        self.stop()

    def __enter__(self) -> "Executor":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def thread_share(threads: int) -> dict[str, str]:
    """The variables that give a process so many threads; what the user has set to something else than the usual is left alone."""
    usual = str(default_threads())
    return {name: str(threads) for name in THREAD_VARIABLES if os.environ.get(name, usual) == usual}


def last_line(said: str, code: int) -> str:
    """What a process ended with, from its stderr."""
    lines = said.strip().splitlines() or [f"ended with {code} and no message"]
    return lines[-1].removeprefix("error: ")
