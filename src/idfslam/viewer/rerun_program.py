"""Finds rerun's package and program, and checks whether a display and ports are available."""

import os
import socket
import sys
from pathlib import Path
from typing import Any, Literal

from idfslam.errors import ConfigError, pip_install

RECORDING = "recording.rrd"  # the recorded live view in a result folder
PORT = 9090  # of the page for a browser, as in rerun; the data is served on PORT + 1

Place = Literal["window", "web", "file"]  # where a run is shown
ViewerOption = Literal["none", "auto", "window", "web", "file"]  # what --viewer accepts; auto: a window if there is a display, else web


def has_display() -> bool:
    """Whether this machine can open a window."""
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_ports(port: int) -> None:
    """Raises ConfigError if `port` or `port` + 1 is in use."""
    for number in (port, port + 1):
        with socket.socket() as test:
            if os.name != "nt":  # on Windows this option lets two programs share a port
                test.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                test.bind(("0.0.0.0", number))
            except (OSError, OverflowError) as error:
                raise ConfigError(
                    f"port {number} cannot be used ({error}); choose a PORT with --port such that PORT and PORT+1 are free"
                ) from error


def pages(port: int) -> str:
    """The origin that may request the data (CORS): the page on `port`, under any name of this machine."""
    return f"http://*:{port}"


def program() -> str:
    """The path of the viewer's binary in rerun's package. It is found even if the Python environment is not activated."""
    import rerun_cli

    name = {"nt": "rerun.exe"}.get(os.name, "rerun")
    bundle = Path("Rerun.app", "Contents", "MacOS", "Rerun")  # on a Mac
    places = [Path(rerun_cli.__file__).parent / place for place in (bundle, name)]
    return str(next(place for place in places if place.exists()))


def rerun() -> Any:
    """The rerun package. Raises ConfigError if it is not installed."""
    try:
        import rerun as package
    except ImportError:
        raise ConfigError(f"the viewer needs rerun, which is not installed: {pip_install('rerun-sdk')}") from None
    return package
