"""How much a command tells: `-q` for warnings, errors and results alone, `-v` for details."""

import logging
import sys
from collections.abc import Sequence
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


class Verbosity(Enum):
    """How much is told. Its value is the least level of log lines of this package that are shown."""

    QUIET = logging.WARNING  # no progress either
    NORMAL = logging.INFO  # loops closed, a lost camera found
    VERBOSE = logging.DEBUG  # and the traceback of an error


_FLAGS = {"-q": Verbosity.QUIET, "--quiet": Verbosity.QUIET, "-v": Verbosity.VERBOSE, "--verbose": Verbosity.VERBOSE}


def take_verbosity(arguments: Sequence[str]) -> tuple[list[str], Verbosity]:
    """The arguments without -q and -v, which may stand before or after the command's name, and what they say. The last one counts."""
    given = [_FLAGS[word] for word in arguments if word in _FLAGS]
    return [word for word in arguments if word not in _FLAGS], given[-1] if given else Verbosity.NORMAL


def open_console(verbosity: Verbosity) -> "Console":
    """The console for progress, on stderr, to which log lines go as well. A warning is one line in a file and wrapped in a terminal."""
    from rich.console import Console
    from rich.logging import RichHandler

    quiet = verbosity is Verbosity.QUIET
    console = Console(stderr=True, quiet=quiet)
    handler: logging.Handler
    if console.is_interactive:
        shown = Console(stderr=True) if quiet else console  # the same console, or lines would be written across the progress bar
        handler = RichHandler(console=shown, show_time=False, show_path=False, markup=False)
        handler.setFormatter(logging.Formatter("%(message)s"))
    else:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(_OneLine())
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    logging.getLogger("idfslam").setLevel(verbosity.value)
    logging.captureWarnings(True)  # warnings of libraries are for developers
    logging.getLogger("py.warnings").setLevel(logging.WARNING if verbosity is Verbosity.VERBOSE else logging.ERROR)
    return console


class _OneLine(logging.Formatter):
    """`warning: MESSAGE`; a message that only informs stands alone."""

    def format(self, record: logging.LogRecord) -> str:
        message = super().format(record)
        return message if record.levelno < logging.WARNING else f"{record.levelname.lower()}: {message}"
