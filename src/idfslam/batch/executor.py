"""The base class of executors, which run modules as processes on this machine (`local_executor`) or on a Ray cluster (`ray_executor`).

Each run is a process of its own, so that its memory and its failure affect no other run. A process that is killed (out of memory, a node
that fails) is started again. A process that ends with an error is not: it would fail again.
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

_NODE_FAILURES = 10  # attempts that failures of nodes may cost a run, apart from --retries; more: a broken cluster is reported later
_LONGEST_WAIT = 60.0  # [s] between two attempts; longer: a node that is back is used later. Both chosen by hand
THREAD_VARIABLES = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class JobOutcome:
    """How a process ended."""

    error: str | None  # the last line of its stderr; None: success
    seconds: float  # of the last attempt
    host: str
    attempts: int = 1


class Crash(Exception):
    """A process was killed. Another attempt may succeed."""


class NodeFailure(Crash):
    """The machine under a process failed. That says nothing about the process, and attempts are counted apart."""


class Executor(ABC):
    """Runs modules as processes, `workers` of them at once. Use it in a `with` block: at its end no process is left running."""

    def __init__(self, workers: int, *, retries: int = 0, wait: float = 0.0) -> None:
        """retries: how often a killed process is started again. wait: [s] before the second attempt; each later one waits twice as long."""
        if workers < 1:
            raise ConfigError(f"--workers {workers}, expected at least 1")
        self.workers, self.retries, self.wait = workers, retries, wait
        self._stopped = threading.Event()

    @abstractmethod
    def _attempt(self, module: str, arguments: tuple[str, ...]) -> tuple[str | None, str]:
        """Runs the module once. Returns the error, if any, and the host. Raises Crash if the process was killed."""

    def run_module(self, module: str, *arguments: str) -> JobOutcome:
        """Runs `python -m MODULE ARGUMENTS` and waits for its end. May be called from several threads at once."""
        error: str | None = INTERRUPTED
        host, seconds, attempt, crashes, node_failures = platform.node(), 0.0, 0, 0, 0
        while not self._stopped.is_set():
            attempt += 1
            start = perf_counter()
            try:
                error, host = self._attempt(module, arguments)
            except Crash as crash:
                node_failures += isinstance(crash, NodeFailure)
                crashes += not isinstance(crash, NodeFailure)
                error, seconds = str(crash), perf_counter() - start
                log.warning("%s (attempt %d): %s", error, attempt, " ".join(arguments[:2]))
                if crashes > self.retries or node_failures > _NODE_FAILURES:
                    break
                self._stopped.wait(min(self.wait * 2 ** (attempt - 1), _LONGEST_WAIT))
                continue
            return JobOutcome(error, perf_counter() - start, host, attempt)
        return JobOutcome(error, seconds, host, attempt)

    def map_unordered(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Calls `function` for each item, `workers` at once. Yields results as they complete. After Ctrl-C no further call starts."""
        with ThreadPoolExecutor(self.workers) as pool:
            futures = [pool.submit(function, item) for item in items]
            try:
                for future in as_completed(futures):
                    yield future.result()
            except BaseException:
                self.stop()
                raise

    def stop(self) -> None:
        """Starts no further process. Running ones receive the terminal's Ctrl-C too, and end after writing their results so far."""
        self._stopped.set()

    def close(self) -> None:
        """Ends all processes."""
        self.stop()

    def __enter__(self) -> "Executor":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def thread_share(threads: int) -> dict[str, str]:
    """The environment variables that give a process `threads` threads. A variable that the user has set to another value is left out."""
    default = str(default_threads())
    return {name: str(threads) for name in THREAD_VARIABLES if os.environ.get(name, default) == default}


def last_line(stderr: str, code: int) -> str:
    """The error message of a process that ended with exit status `code`: the last line of its stderr."""
    lines = stderr.strip().splitlines() or [f"ended with exit status {code} and no message"]
    return lines[-1].removeprefix("error: ")
