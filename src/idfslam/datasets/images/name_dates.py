"""Dates with a time in the names of a series of files, such as 2023-05-01_12-30-15.123456: they become seconds since 1970."""

import re
from collections.abc import Sequence
from datetime import datetime, timezone

import numpy as np

_DATE = re.compile(
    r"(?<!\d)((?:19|20)\d\d)([-_.]?)([01]\d)\2([0-3]\d)[-_. T]?"  # 2023-05-01, 20230501
    r"([0-2]\d)([-_.:hH]?)([0-5]\d)[-_.:mM]?([0-6]\d)"  # 12-30-15, 123015
    r"(?:[-_.,:sS]?(\d{3}|\d{6}|\d{9}))?Z?(?!\d)"  # milliseconds, microseconds or nanoseconds
)
_STEP = (2e-3, 100.0)  # [s] from file to file in the median; widened, a counter behind a date is taken for a fraction of a second.
#    Chosen by hand: 500 frames/s to time lapse


def with_seconds(stems: Sequence[str]) -> list[str] | None:
    """The names with seconds since 1970 in place of a date with a time; None if not all have one, or if it is not that of the file."""
    found = [(stem, match) for stem in stems if (match := _DATE.search(stem))]
    if len(found) < max(len(stems), 2):
        return None
    try:
        seconds = [_seconds(match) for _, match in found]
    except ValueError:  # the 31st of February
        return None
    steps = np.diff(np.sort(np.array(seconds, np.float64)))
    if not (steps > 0).all() or not _STEP[0] <= np.median(steps) <= _STEP[1]:
        return None
    return [stem[: match.start()] + text + stem[match.end() :] for text, (stem, match) in zip(seconds, found)]


def _seconds(match: re.Match[str]) -> str:
    """Seconds since 1970 [UTC] as they are written, with the digits behind the point."""
    year, _, month, day, hour, _, minute, second, fraction = match.groups()
    moment = datetime(*map(int, (year, month, day, hour, minute, second)), tzinfo=timezone.utc)  # type: ignore[misc, arg-type]
    return f"{int(moment.timestamp())}.{fraction or 0}"
