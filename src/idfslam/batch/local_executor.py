"""Runs modules as processes of this machine."""

import os
import platform
import signal
import subprocess
import sys

from idfslam.batch.executor import Crash, Executor, last_line, thread_share
from idfslam.compute.host import default_threads


class LocalExecutor(Executor):
    """Processes of this machine, each with its share of the cores."""

    def __init__(self, workers: int = 1, *, retries: int = 0) -> None:
        super().__init__(workers, retries=retries)
        self._environment = os.environ | thread_share(default_threads(workers))
        self._running: set[subprocess.Popen[str]] = set()

    def _attempt(self, module: str, arguments: tuple[str, ...]) -> tuple[str | None, str]:
        command = [sys.executable, "-m", module, *arguments]
        discard, pipe = subprocess.DEVNULL, subprocess.PIPE
        with subprocess.Popen(command, stdout=discard, stderr=pipe, text=True, env=self._environment) as process:
            self._running.add(process)
            try:
                stderr = process.communicate()[1]
            finally:
                self._running.discard(process)
        if process.returncode < 0:
            raise Crash(f"killed by {signal.Signals(-process.returncode).name}")
        return (None if process.returncode == 0 else last_line(stderr, process.returncode)), platform.node()

    def close(self) -> None:
        super().close()
        for process in tuple(self._running):
            process.kill()
