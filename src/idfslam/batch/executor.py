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
    """A process was killed or its node failed. Another attempt may succeed."""


class Executor(ABC):
    """Runs modules as processes, `workers` of them at once. Use it in a `with` block: at its end no process is left running."""

    def __init__(self, workers: int, *, retries: int = 0) -> None:
        """retries: how often a killed process is started again."""
        if workers < 1:
            raise ConfigError(f"--workers {workers}, expected at least 1")
        self.workers, self.retries = workers, retries
        self._stopped = threading.Event()

    @abstractmethod
    def _attempt(self, module: str, arguments: tuple[str, ...]) -> tuple[str | None, str]:
        """Runs the module once. Returns the error, if any, and the host. Raises Crash if the process was killed."""

    def run_module(self, module: str, *arguments: str) -> JobOutcome:
        """Runs `python -m MODULE ARGUMENTS` and waits for its end. May be called from several threads at once."""
        error: str | None = INTERRUPTED
        host, seconds, attempt = platform.node(), 0.0, 0
        while attempt <= self.retries and not self._stopped.is_set():
            attempt += 1
            start = perf_counter()
            try:
                error, host = self._attempt(module, arguments)
            except Crash as crash:
                error, seconds = str(crash), perf_counter() - start
                log.warning("%s (attempt %d of %d): %s", error, attempt, self.retries + 1, " ".join(arguments[:2]))
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
