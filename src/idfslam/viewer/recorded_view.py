"""Shows the recorded live view of a finished run."""

import os
import subprocess
from contextlib import suppress
from pathlib import Path

from idfslam.errors import ResultError
from idfslam.viewer import rerun_program
from idfslam.viewer.rerun_program import LOOPBACK, PORT, RECORDING
from idfslam.viewer.rerun_viewer import RerunViewer


def show(folder: Path, *, web: bool, port: int = PORT, host: str = LOOPBACK) -> None:
    """Shows the recording.rrd of a result folder in a window or a browser, until the window is closed or Ctrl-C is pressed.

    Raises ResultError if there is no such file, ConfigError as `RerunViewer` does.
    """
    path = folder / RECORDING
    if not path.is_file():
        found = "no such folder" if not folder.is_dir() else f"has no {RECORDING}"
        raise ResultError(f"{folder}: {found}; expected the results of `idf-slam run PATH --viewer`, which records what it shows")
    viewer = RerunViewer("web" if web else "window", port=port, host=host)
    command = [rerun_program.program(), str(path)]
    if web:
        print(f"{viewer.address()}   (Ctrl-C ends)\n{rerun_program.listening(port, host)}", flush=True)
        command = rerun_program.serve_command(port, host, str(path))
    environment = rerun_program.environment()
    if os.name == "posix":
        os.execve(command[0], command, environment)  # replaces this process, so that no parent can end and leave the viewer behind
    with suppress(KeyboardInterrupt):
        subprocess.run(command, env=environment, check=False)
