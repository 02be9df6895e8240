"""The standard streams of the process: text that a console cannot show is escaped, and a closed stream takes what is written to it."""

import io
import os
import sys


def prepare_streams() -> None:
    """Prepares stdin, stdout and stderr. It must be called before a file is opened, which would take the number of a closed stream."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, which is this one
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (open as long as the process)
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # consoles of Windows, or LANG=C: not every character can be encoded
