"""The numbers in the names of a series of files: which of them counts the files, and whether one is a time stamp.

Dates with a time count as seconds since 1970. Hexadecimal names count as one number.
"""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.images.name_dates import with_seconds
from idfslam.datasets.time_stamps import UNITS

_HEXADECIMAL = re.compile(r"[0-9a-f]{4,13}", re.IGNORECASE)  # of so many digits that a double holds the number

_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_SIZE = re.compile(r"(?<!\d)\d+x\d+(?!\d)")  # 640x480
_SECONDS_NANOSECONDS = re.compile(r"(?<!\d)(\d{10})[_-](\d{9})(?!\d)")  # ROS: 1403636579_763555584

_EPOCH = (5e8, 5e9)  # [s] since 1970 that count as a time stamp: 1985 to 2128. Wider, dates such as 20240131 are taken for one
_DECIMAL_SECONDS = (1e-3, 2.0)  # [s] steps between names that are stamps of a camera's own clock. Wider, here and in the four below: other
#    numbers are taken for stamps. Chosen by hand
_DECIMAL_MILLISECONDS = (2.0, 2000.0)  # [ms] likewise, with digits behind a point
_MICROSECONDS = (4e3, 1e6)  # [us] likewise, whole numbers
_NANOSECONDS = (4e6, 1e10)  # [ns] likewise, whole numbers
_STEADY = 0.25  # [1] how much a step may differ from the median step and still count as regular; raised, chosen frames look like a clock
_MILLISECONDS = (8.0, 500.0)  # [ms] likewise, whole ones, whose rounding shows: 33, 67, 100


def counting_numbers(stems: Sequence[str]) -> list[str | None]:
    """The number of each name that counts the series, as it is written: the last that differs from file to file; None: no number.

    Without such a number it is the last that is no part of a size like 640x480.
    """
    stems = _comparable(stems)
    columns = _columns(stems)
    if columns is None:
        return [_last(stem) for stem in stems]
    distinct = [column for column in columns if len({float(text) for text in column}) == len(column)]
    varying = [column for column in columns if len(set(column)) > 1]
    return list((distinct or varying or columns)[-1])


def name_stamps(stems: Sequence[str]) -> NDArray[np.float64] | None:
    """(N,) time stamps [s] in the names, which are in the order of time; None if the names hold none.

    Seconds, milliseconds, microseconds or nanoseconds since 1970, or of a camera's clock if the steps between them say so.
    """
    for column in reversed(_columns(_comparable(stems)) or []):
        unit = _units_per_second(column)
        if unit is not None and np.all(np.diff(stamps := np.array([float(text) for text in column]) / unit) > 0):
            return np.asarray(stamps, np.float64)
    return None


def _comparable(stems: Sequence[str]) -> list[str]:
    """The names with decimal numbers in place of dates and of hexadecimal numbers."""
    if _are_hexadecimal(stems):
        return [str(int(stem, 16)) for stem in stems]
    return with_seconds(stems) or list(stems)


def _are_hexadecimal(stems: Sequence[str]) -> bool:
    """Whether the names have one length, and letters where others have digits: `a0001` is a letter before a decimal number."""
    if not stems or len(set(map(len, stems))) > 1 or not all(map(_HEXADECIMAL.fullmatch, stems)):
        return False
    return any(len({c.isdigit() for c in place}) == 2 for place in zip(*stems))


def _columns(stems: Sequence[str]) -> list[tuple[str, ...]] | None:
    """The first, second ... numbers of all names; None if the names do not have equally many, or none."""
    rows = [_NUMBER.findall(_SIZE.sub("x", _SECONDS_NANOSECONDS.sub(r"\1.\2", stem))) for stem in stems]
    return list(zip(*rows)) if rows and rows[0] and len({len(row) for row in rows}) == 1 else None


def _last(stem: str) -> str | None:
    numbers = _NUMBER.findall(_SECONDS_NANOSECONDS.sub(r"\1.\2", stem))
    return numbers[-1] if numbers else None


def _units_per_second(texts: Sequence[str]) -> float | None:
    """Units per second of numbers that are time stamps; None if they are not."""
    values = np.array([float(text) for text in texts])
    for unit in UNITS:
        if np.all((values >= _EPOCH[0] * unit) & (values <= _EPOCH[1] * unit)):
            return unit
    if len(values) < 3:
        return None
    steps = np.diff(values)
    step = float(np.median(steps))
    within: tuple[tuple[tuple[float, float], float], ...]
    if np.mean(["." in text for text in texts]) > 0.5:
        within = ((_DECIMAL_SECONDS, 1.0), (_DECIMAL_MILLISECONDS, 1e3))
    else:
        steady = float(np.mean(np.abs(steps - step) <= _STEADY * step)) > 0.5
        rounded = steady and np.ptp(steps) > 0  # steps that are all equal: every tenth frame, perhaps
        within = (*([(_MILLISECONDS, 1e3)] if rounded else []), (_MICROSECONDS, 1e6), (_NANOSECONDS, 1e9))
    return next((unit for (low, high), unit in within if low <= step < high), None)
