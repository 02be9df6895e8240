"""Reads timestamps.txt of a plain folder: lines `number stamp` [s] with the images' numbers, or one stamp a line in the images' order."""

from pathlib import Path

import numpy as np

from idfslam.errors import RecordingError

STAMPS = "timestamps.txt"


def read_stamps(path: Path, numbers: list[float]) -> dict[float, float] | None:
    """The stamps [s] by frame number, sorted by number; None without the file. `numbers`: those of the images, in order.

    A last line `number stamp` without a line break was cut off while it was written: it is left out.
    Raises RecordingError if a line has another form, and if stamps do not increase.
    """
    if not path.is_file():
        return None
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True)
    rows = [row for line, text in enumerate(lines, 1) if text.endswith("\n") and (row := _row(text, f"{path}: line {line}"))]
    if lines and not lines[-1].endswith("\n") and len(lines[-1].split()) == 1 and all(len(row) == 1 for row in rows):
        rows.append(_row(lines[-1], f"{path}: line {len(lines)}"))  # written by hand
    if rows and all(len(row) == 1 for row in rows):
        if len(rows) != len(numbers):
            raise RecordingError(
                f"{path}: {len(rows)} stamps for {len(numbers)} images, expected one for each: complete or remove the file"
            )
        rows = [(number, *row) for number, row in zip(numbers, rows)]
    if short := [row for row in rows if len(row) == 1]:
        raise RecordingError(f"{path}: '{short[0][0]}' is alone in its line, expected the number of a frame and its stamp")
    stamps = dict(sorted((row[0], row[1]) for row in rows))
    late = np.diff(list(stamps.values())) <= 0
    if late.any():
        number = list(stamps)[int(late.argmax()) + 1]
        raise RecordingError(
            f"{path}: frame {number:.15g} is not later than the one before it, expected stamps in the order of the numbers"
        )
    return stamps


def _row(text: str, source: str) -> tuple[float, ...]:
    """The one or two numbers of a line; empty for an empty line and a comment."""
    words = text.split("#")[0].split()
    try:
        row = tuple(map(float, words))
    except ValueError:
        row = (np.nan,)
    if len(row) > 2 or not np.isfinite(row).all():
        raise RecordingError(f"{source} is '{text.strip()}', expected a stamp in seconds, or the number of a frame and its stamp")
    return row
