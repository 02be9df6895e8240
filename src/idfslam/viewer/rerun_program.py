"""rerun as it is installed here: its package and its program, and where they can show something."""

import os
import socket
import sys
from pathlib import Path
from typing import Any

from idfslam.errors import ConfigError

RECORDING = "recording.rrd"  # the file of a result folder that keeps what the viewer showed


def has_display() -> bool:
    """Whether a window can be opened."""
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_ports(port: int) -> None:
    """Raises ConfigError where the port or the one after it is in use."""
    for number in (port, port + 1):
        with socket.socket() as trial:
            if os.name != "nt":  # where it would let two programs share a port
                trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                trial.bind(("0.0.0.0", number))
            except (OSError, OverflowError) as error:
                raise ConfigError(f"port {number} cannot be served on ({error}); choose another one, and the next, with --port") from error


def pages(port: int) -> str:
    """The pages that may ask for the data: ours, by whatever name of this machine they were found."""
    return f"http://*:{port}"


def program() -> str:
    """The viewer's binary in rerun's package, whether the environment is activated or not."""
    import rerun_cli

    name = {"nt": "rerun.exe"}.get(os.name, "rerun")
    bundle = Path("Rerun.app", "Contents", "MacOS", "Rerun")  # on a Mac
    places = [Path(rerun_cli.__file__).parent / place for place in (bundle, name)]
    return str(next(place for place in places if place.exists()))


def rerun() -> Any:
    """The package. Raises ConfigError where it is not installed."""
    try:
        import rerun as package
    except ImportError:
        raise ConfigError("the viewer needs rerun, which is not installed: pip install 'idf-slam[viewer]'") from None
    return package
