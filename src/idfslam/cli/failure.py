"""How a command ends on errors: with one line on stderr and an exit status. The traceback of a fault of the program goes to a file."""

import errno
import os
import re
import sys
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

from idfslam.cli.usage import version_line
from idfslam.errors import IdfSlamError

FAILED, INTERRUPTED = 1, 130  # 128 + SIGINT, as shells have it
_NO_MEMORY = re.compile("(can't|cannot|failed to|unable to) allocate|insufficient memory|out of memory", re.IGNORECASE)  # torch, OpenCV


@contextmanager
def one_line_errors(*, verbose: bool = False) -> Iterator[None]:
    """A context in which every error ends the program with one line and a status. verbose: the traceback is printed before it."""
    try:
        yield
        sys.stdout.flush()  # so that what cannot be written is known here and not at the end of the process
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        raise SystemExit(INTERRUPTED) from None
    except BrokenPipeError:  # whoever read the output has gone, as `head` does
        _forget_output()
        raise SystemExit(FAILED) from None
    except Exception as error:
        if verbose:
            traceback.print_exc()
        print(f"error: {message(error)}", file=sys.stderr)
        if isinstance(error, OSError):
            _forget_output()
        raise SystemExit(FAILED) from error


def message(error: Exception) -> str:
    """What an error means to the user, in one line. An error that nobody expected is written to a file with its traceback."""
    text = " ".join(str(error).split())
    if isinstance(error, IdfSlamError):
        return str(error)
    if isinstance(error, MemoryError) or _NO_MEMORY.search(text):
        return f"out of memory ({text or 'while computing'}); close other programs, or use fewer frames (--frames, --stride)"
    if isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename is not None else ""
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return f"{place}no space is left on the disk; make room and run again"
        return f"{place}{error.strerror or text}"
    if isinstance(error, ImportError):
        return f"a package cannot be loaded ({text}); install idf-slam again, or this package alone"
    return f"unexpected {type(error).__name__}: {text[:200]}; this is a fault of idf-slam, please report it with {_report(error)}"


def _report(error: Exception) -> str:
    """Writes version, command line and traceback to a file of the temporary folder. Returns its path."""
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="idf-slam-error-", suffix=".log", delete=False, encoding="utf-8", errors="backslashreplace"
        ) as file:
            file.write(f"{version_line()}\n{' '.join(sys.argv)}\n\n{''.join(traceback.format_exception(error))}")
        return file.name
    except OSError:
        return "what the option -v prints"


def _forget_output() -> None:
    """Discards what is still buffered for stdout, or Python would fail once more when it flushes at its end."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
