"""Finds rerun's package and program, and checks whether a display and ports are available."""

import os
import socket
import sys
from pathlib import Path
from typing import Any, Literal

from idfslam.errors import ConfigError, pip_install

RECORDING = "recording.rrd"  # the recorded live view in a result folder
PORT = 9090  # of the page for a browser, as in rerun: a larger number by one is the port of the data
LOOPBACK = "127.0.0.1"  # the default address that page and data listen on: this machine alone reaches them

Place = Literal["window", "web", "file"]  # where a run is shown
ViewerOption = Literal["none", "auto", "window", "web", "file"]  # what --viewer accepts; auto: a window if there is a display, else web


def has_display() -> bool:
    """Whether this machine can open a window."""
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_ports(port: int, host: str = LOOPBACK) -> None:
    """Raises ConfigError if `port` or `port` + 1 of the address `host` is in use, or if `host` is no address of this machine."""
    for number in (port, port + 1):
        with socket.socket() as test:
            if os.name != "nt":  # on Windows this option lets two programs share a port
                test.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                test.bind((host, number))
            except (OSError, OverflowError) as error:
                raise ConfigError(
                    f"port {number} cannot be used on {host} ({error}); choose a PORT with --port such that PORT and PORT+1 are free"
                ) from error


def listening(port: int, host: str) -> str:
    """Where page and data listen, in one line, with a warning if other machines can reach them."""
    line = f"listening on {host}, ports {port} (page) and {port + 1} (data)"
    open_to_all = host != LOOPBACK and host != "localhost"
    return f"{line}; every machine that reaches this address can look on, without a password" if open_to_all else line


def serve_command(port: int, host: str, source: str) -> list[str]:
    """The command that serves the page, and the data of `source` unless it is the address of a server."""
    ports = ["--web-viewer-port", str(port), "--port", str(port + 1)]
    return [program(), source, "--serve-web", "--bind", host, *ports, "--cors-allow-origin", pages(port)]


def environment() -> dict[str, str]:
    """The variables for rerun's program: few log lines, and no usage statistics, which rerun does not send from builds on servers (CI)."""
    return {"RUST_LOG": "warn", "CI": "true"} | os.environ


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
