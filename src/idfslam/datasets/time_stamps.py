"""Time stamps as recorders leave them, made seconds that increase: other units, missing, equal and backward stamps.

A unit is recognised by the step from frame to frame; where few frames are there, by the size of the stamps, which count from 1970.
"""

import logging
from bisect import bisect_left

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.association import TOLERANCE

log = logging.getLogger(__name__)

UNITS = (1.0, 1e3, 1e6, 1e9)  # [1/s] in which stamps are written; more: stamps in seconds may be taken for those of a unit
_NAMES = {1e9: "nanoseconds", 1e6: "microseconds", 1e3: "milliseconds"}
_STEPS = {1e9: 1e6, 1e6: 2e3, 1e3: 5.0}  # smallest median step of a unit [in it]: 1000 to 200 frames/s; raised, quick cameras in a unit
#    are taken to be slow ones in the next one. A step of more than 5 s is no video
_SINCE_1970 = {1e9: 1e17, 1e6: 1e14, 1e3: 1e11}  # smallest stamp of a unit that counts from 1970 [in it]: the year 1973
_NOW = (9e8, 3e9)  # [s] since 1970, the years 1998 to 2065: what lies between is in seconds; wider: milliseconds since the start of the
#    recording too
_SLOWEST = 3600.0  # [s] largest median step of such stamps; raised, nanoseconds since the start of the recording may be taken for seconds
_USABLE = 0.5  # [1] share of stamps that must increase; raised, more recordings get regular stamps. Chosen by hand


def units_per_second(stamps: NDArray[np.float64]) -> float:
    """1e9, 1e6, 1e3 or 1: in which unit stamps (N,) are written."""
    finite = stamps[np.isfinite(stamps)]
    steps = np.abs(np.diff(finite))
    steps = steps[steps > 0]
    typical = float(np.median(np.abs(finite))) if len(finite) else 0.0
    step = float(np.median(steps)) if len(steps) >= 2 else None
    if _NOW[0] < typical < _NOW[1] and (step or 0.0) < _SLOWEST:
        return 1.0
    measured, bounds = (typical, _SINCE_1970) if step is None else (step, _STEPS)
    return next((unit for unit, bound in bounds.items() if measured > bound), 1.0)


def in_seconds(stamps: NDArray[np.float64], source: str = "") -> NDArray[np.float64]:
    """Stamps (N,) in seconds. Where they are in another unit, one warning names `source`; an empty one means no warning."""
    unit = units_per_second(stamps)
    if unit == 1.0:
        return stamps
    if source:
        log.warning("%s: the stamps are taken for %s, and converted to seconds", source, _NAMES[unit])
    return np.asarray(stamps / unit, np.float64)


def in_seconds_near(stamps: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Stamps (M,), converted from the unit in which they overlap in time with `reference` (N,) [s]; unchanged if there is none."""
    for unit in UNITS:
        if stamps.min() / unit <= reference.max() + TOLERANCE and reference.min() - TOLERANCE <= stamps.max() / unit:
            return np.asarray(stamps / unit, np.float64) if unit != 1 else stamps
    return stamps


def increasing(stamps: NDArray[np.float64], source: str) -> NDArray[np.float64] | None:
    """Finite stamps (N,) [s] that increase: those that do not are interpolated between the others, with one warning.

    None if they cannot be used: fewer than half of them increase.
    """
    good = _longest_increasing(stamps)
    if good.all():
        return stamps
    first, bad = int((~good).argmax()), int((~good).sum())
    found = f"{bad} of {len(stamps)} stamps are missing, or not later than the one before (the first at frame {first})"
    if good.sum() < max(2, _USABLE * len(stamps)):
        log.warning("%s: %s; 30 frames/s are assumed", source, found)
        return None
    log.warning("%s: %s; they are interpolated", source, found)
    places, known = np.flatnonzero(good), stamps[good]
    step = float(np.median(np.diff(known) / np.diff(places)))
    index = np.arange(len(stamps))
    repaired = np.interp(index, places, known)
    before, after = index < places[0], index > places[-1]
    repaired[before] = known[0] + step * (index[before] - places[0])
    repaired[after] = known[-1] + step * (index[after] - places[-1])
    return repaired


def _longest_increasing(stamps: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N,) whether each stamp belongs to the longest increasing series of finite stamps (patience sorting, N log N)."""
    if np.isfinite(stamps).all() and (np.diff(stamps) > 0).all():
        return np.ones(len(stamps), bool)
    ends: list[float] = []  # ends[k]: the smallest end of a series of k + 1 stamps
    end_index: list[int] = []
    before = np.full(len(stamps), -1)
    for i, stamp in enumerate(stamps.tolist()):
        if not np.isfinite(stamp):
            continue
        k = bisect_left(ends, stamp)
        if k < len(ends) and ends[k] == stamp:  # of equal stamps the first one counts
            continue
        before[i] = end_index[k - 1] if k else -1
        ends[k : k + 1], end_index[k : k + 1] = [stamp], [i]
    good = np.zeros(len(stamps), bool)
    i = end_index[-1] if end_index else -1
    while i >= 0:
        good[i], i = True, before[i]
    return good
