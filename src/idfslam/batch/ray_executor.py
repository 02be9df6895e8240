"""Runs on a Ray cluster: that of an address, the one that this machine belongs to, or one of this machine's own cores.

Paths must lead to the same files on every node (a shared file system), and every node must have the package. A run is a task in a
worker process of its own, which ends with it: what kills the run kills the worker, and Ray tells.
"""

import importlib
import io
import logging
import platform
import socket
import threading
import traceback
from contextlib import redirect_stderr, redirect_stdout
from typing import Any

from idfslam.batch.executor import INTERRUPTED, THREAD_VARIABLES, Crash, Executor, last_line
from idfslam.compute.host import MOST_THREADS
from idfslam.errors import ConfigError

_AUTO = "auto"
_PATIENCE = 5.0  # [s] for an answer from the cluster


class RayExecutor(Executor):
    """Processes anywhere in a cluster; each asks for its share of the cores, and for `gpus` (a fraction: several runs share one)."""

    def __init__(self, address: str, workers: int | None, *, jobs: int, gpus: float = 0.0, retries: int = 0) -> None:
        """Raises ConfigError where Ray is not installed, the cluster cannot be reached, or no node has what a run needs."""
        self._ray = _connected(address)
        total, largest = self._size("CPU")
        super().__init__(max(1, min(jobs, int(total))) if workers is None else workers, retries=retries)
        if gpus > self._size("GPU")[1]:
            raise ConfigError(f"--gpus {gpus:g}: the nodes of the cluster have at most {self._size('GPU')[1]:g}")
        threads = max(1, min(int(total / self.workers), int(largest), MOST_THREADS))
        variables = dict.fromkeys(THREAD_VARIABLES, str(threads)) | {"OMP_WAIT_POLICY": "PASSIVE", "GOMP_SPINCOUNT": "0"}
        share = {"num_cpus": threads, "num_gpus": gpus, "runtime_env": {"env_vars": variables}}
        self._task = self._ray.remote(max_calls=1, max_retries=0, **share)(run_here)
        self._running: set[Any] = set()
        self._lock = threading.Lock()

    def _size(self, resource: str) -> tuple[float, float]:
        """How much of it the cluster has, and its largest node."""
        found = [float(node["Resources"].get(resource, 0)) for node in self._ray.nodes() if node["Alive"]]
        return sum(found), max(found, default=0.0)

    def _attempt(self, module: str, arguments: tuple[str, ...]) -> tuple[str | None, str]:
        errors = self._ray.exceptions
        with self._lock:
            if self._stopped.is_set():
                return INTERRUPTED, platform.node()
            task = self._task.remote(module, arguments)
            self._running.add(task)
        try:
            error, where = self._ray.get(task)
        except errors.TaskCancelledError:
            return INTERRUPTED, platform.node()
        except (errors.WorkerCrashedError, errors.NodeDiedError, errors.OutOfMemoryError, errors.LocalRayletDiedError) as crash:
            raise Crash(f"the worker died ({type(crash).__name__})") from crash
        finally:
            self._running.discard(task)
        return error, where

    def stop(self) -> None:
        """No process is started any more; those that run get a Ctrl-C of their own, for Ray keeps the terminal's from them."""
        with self._lock:
            first = not self._stopped.is_set()
            super().stop()
        for task in tuple(self._running) if first else ():
            self._ray.cancel(task, force=False)

    def close(self) -> None:
        super().close()
        self._ray.shutdown()


def _connected(address: str) -> Any:
    """The module `ray`, connected. Raises ConfigError."""
    try:
        import ray
    except ImportError:
        raise ConfigError("--cluster needs Ray: pip install 'idf-slam[cluster]'; without --cluster this machine's cores are used") from None
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
    """Raises ConfigError where nobody listens at HOST:PORT or ray://HOST:PORT: Ray itself would wait for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        with socket.create_connection((host, int(port)), timeout=_PATIENCE):
            pass
    except (OSError, ValueError, OverflowError) as error:
        raise ConfigError(f"--cluster {address}: {error}; expected 'auto' or the address of a Ray cluster, such as HOST:6379") from error


def run_here(module: str, arguments: tuple[str, ...]) -> tuple[str | None, str]:
    """`python -m MODULE ARGUMENTS` in this process, which is a worker of its own: the error, if any, and the host."""
    said, error = io.StringIO(), None
    with redirect_stderr(said), redirect_stdout(io.StringIO()):
        try:
            importlib.import_module(module).main(list(arguments))
        except SystemExit as end:
            error = last_line(said.getvalue(), int(end.code or 0)) if end.code else None
        except Exception as fault:  # a fault of ours: its last line goes the way that it would from a process's stderr
            error = traceback.format_exception_only(fault)[-1].strip()
    return error, platform.node()
