"""Which depth image each colour image has: its own, else the nearest in time, else none. So every colour image is a frame."""

import logging

import numpy as np
from numpy.typing import NDArray

log = logging.getLogger(__name__)

_REACH = 1.1  # [1] of the time between colour images, up to which the depth image of another moment is taken; raised, depth of older
#    moments is. One image time and its jitter, chosen by hand
_FARTHEST = 0.1  # [s] likewise, whatever the time between images; raised, depth of another view is taken where few images a second come.
#    Chosen by hand


def with_nearest(pairs: NDArray[np.int64], colour: NDArray[np.float64], depth: NDArray[np.float64]) -> NDArray[np.int64]:
    """(N,) the depth image of each colour image; -1: none.

    pairs: (M, 2) the colour images that have a depth image of their own, and these. colour: (N,), depth: (K,) [s] stamps. A colour image
    without one of its own takes the nearest in time, at most about one image away. It may be another colour image's, too.
    """
    partner = np.full(len(colour), -1)
    partner[pairs[:, 0]] = pairs[:, 1]
    alone = np.flatnonzero((partner < 0) & np.isfinite(colour))
    known = np.flatnonzero(np.isfinite(depth))
    if not len(alone) or not len(known):
        return partner
    order = known[np.argsort(depth[known], kind="stable")]
    times = depth[order]
    after = np.searchsorted(times, colour[alone]).clip(0, len(times) - 1)
    before = (after - 1).clip(0)
    nearer = np.where(np.abs(times[before] - colour[alone]) <= np.abs(times[after] - colour[alone]), before, after)
    steps = np.diff(np.sort(colour[np.isfinite(colour)]))
    reach = min(_FARTHEST, _REACH * float(np.median(steps))) if len(steps) else _FARTHEST
    near = np.abs(times[nearer] - colour[alone]) <= reach
    partner[alone[near]] = order[nearer[near]]
    return partner


def of_frames(has_depth: NDArray[np.bool_], stamps: NDArray[np.float64]) -> NDArray[np.int64]:
    """(N,) the frame whose depth image each frame has; -1: none. For a sensor whose colour and depth images have the same stamps.

    has_depth: (N,) whether a frame has a depth image of its own. stamps: (N,) [s].
    """
    own = np.flatnonzero(has_depth)
    partner = with_nearest(np.stack([own, np.arange(len(own))], 1), stamps, stamps[own])
    return np.where(partner < 0, -1, np.append(own, -1)[partner])


def stamps_of(depth: NDArray[np.float64], partner: NDArray[np.int64]) -> NDArray[np.float64]:
    """(N,) [s] the stamp of each colour image's depth image, NaN where it has none. depth: (K,) [s]; partner: (N,), -1: none."""
    return np.where(partner < 0, np.nan, depth[partner])


def warn_without_own(source: str, own: int, count: int) -> None:
    """One warning if not all of `count` colour images have a depth image of their own, but only `own` of them."""
    if own < count:
        found = f"{count - own} of {count} colour images have no depth image of their own"
        log.warning("%s: %s; they take the nearest in time, or have no depth if none is near", source, found)
