"""Runs modules on a Ray cluster: one at an address, the one that this machine belongs to, or a new one on this machine's cores.

Paths must lead to the same files on every node (a shared file system), and the package must be installed on every node. Each run is a
task in its own worker process, which ends with the task. If the run is killed, so is the worker, and Ray reports it.
"""

import importlib
import io
import logging
import os
import platform
import socket
import threading
import traceback
from contextlib import redirect_stderr, redirect_stdout
from typing import Any

from idfslam.batch.executor import INTERRUPTED, THREAD_VARIABLES, Crash, Executor, NodeFailure, last_line
from idfslam.compute.host import MOST_THREADS
from idfslam.errors import ConfigError, pip_install

_AUTO = "auto"
_WAIT = 5.0  # [s] before a second attempt, so that a node that is failing is known to have failed; longer: attempts last longer
_CONNECT_TIMEOUT = 5.0  # [s] for an answer from the cluster; larger: slow networks work, a wrong address is reported later


class RayExecutor(Executor):
    """Processes on the nodes of a cluster. Each requests its share of the cores, and `gpus` GPUs (a fraction: several runs share one)."""

    def __init__(self, address: str, workers: int | None, *, jobs: int, gpus: float = 0.0, retries: int = 0) -> None:
        """Raises ConfigError if Ray is not installed, if the cluster cannot be reached, or if no node can hold a run."""
        self._ray = _connected(address)
        total, largest = self._size("CPU")
        super().__init__(max(1, min(jobs, int(total))) if workers is None else workers, retries=retries, wait=_WAIT)
        if gpus > self._size("GPU")[1]:
            raise ConfigError(f"--gpus {gpus:g}: the nodes of the cluster have at most {self._size('GPU')[1]:g}")
        threads = max(1, min(int(total / self.workers), int(largest), MOST_THREADS))
        variables = dict.fromkeys(THREAD_VARIABLES, str(threads)) | {"OMP_WAIT_POLICY": "PASSIVE", "GOMP_SPINCOUNT": "0"}
        share = {"num_cpus": threads, "num_gpus": gpus, "runtime_env": {"env_vars": variables}}
        self._task = self._ray.remote(max_calls=1, max_retries=0, **share)(run_here)
        self._running: set[Any] = set()
        self._lock = threading.Lock()

    def _size(self, resource: str) -> tuple[float, float]:
        """The amount of a resource in the whole cluster and in its largest node."""
        amounts = [float(node["Resources"].get(resource, 0)) for node in self._ray.nodes() if node["Alive"]]
        return sum(amounts), max(amounts, default=0.0)

    def _alive(self) -> int:
        """The number of nodes that answer."""
        return sum(bool(node["Alive"]) for node in self._ray.nodes())

    def _attempt(self, module: str, arguments: tuple[str, ...]) -> tuple[str | None, str]:
        errors = self._ray.exceptions
        with self._lock:
            if self._stopped.is_set():
                return INTERRUPTED, platform.node()
            nodes = self._alive()
            task = self._task.remote(module, arguments)
            self._running.add(task)
        try:
            error, where = self._ray.get(task)
        except errors.TaskCancelledError:
            return INTERRUPTED, platform.node()
        except (errors.NodeDiedError, errors.LocalRayletDiedError) as failure:
            raise NodeFailure(f"the node failed ({type(failure).__name__})") from failure
        except (errors.WorkerCrashedError, errors.OutOfMemoryError) as crash:
            if self._alive() < nodes:
                raise NodeFailure(f"the node failed ({type(crash).__name__})") from crash
            raise Crash(f"the worker died ({type(crash).__name__})") from crash
        finally:
            self._running.discard(task)
        return error, where

    def stop(self) -> None:
        """Starts no further process. Running ones are interrupted through Ray, since the terminal's Ctrl-C does not reach them."""
        with self._lock:
            first = not self._stopped.is_set()
            super().stop()
        for task in tuple(self._running) if first else ():
            self._ray.cancel(task, force=False)

    def close(self) -> None:
        super().close()
        self._ray.shutdown()


def _connected(address: str) -> Any:
    """The module `ray`, connected to the cluster. Raises ConfigError if that is not possible."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # Ray would send statistics of its use to its makers
    try:
        import ray
    except ImportError:
        raise ConfigError(f"--cluster needs Ray: {pip_install('ray')}; without it, runs use this machine's cores") from None
    if address != _AUTO:
        _check_reachable(address)
    try:
        options: dict[str, Any] = {} if address == _AUTO else {"address": address}
        ray.init(**options, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR, ignore_reinit_error=True)
    except (ConnectionError, ValueError, RuntimeError) as error:
        line = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise ConfigError(f"--cluster {address}: {line}; expected 'auto' or the address of a Ray cluster, such as HOST:6379") from error
    return ray


def _check_reachable(address: str) -> None:
    """Raises ConfigError if nothing listens at HOST:PORT or ray://HOST:PORT. Ray itself would wait for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        with socket.create_connection((host, int(port)), timeout=_CONNECT_TIMEOUT):
            pass
    except (OSError, ValueError, OverflowError) as error:
        raise ConfigError(f"--cluster {address}: {error}; expected 'auto' or the address of a Ray cluster, such as HOST:6379") from error


def run_here(module: str, arguments: tuple[str, ...]) -> tuple[str | None, str]:
    """Runs `python -m MODULE ARGUMENTS` in this process, which is a worker. Returns the error, if any, and the host."""
    stderr, error = io.StringIO(), None
    with redirect_stderr(stderr), redirect_stdout(io.StringIO()):
        try:
            importlib.import_module(module).main(list(arguments))
        except SystemExit as end:
            error = last_line(stderr.getvalue(), int(end.code or 0)) if end.code else None
        except Exception as fault:  # a bug: its last line is reported, as for a process with a traceback
            error = traceback.format_exception_only(fault)[-1].strip()
    return error, platform.node()
