"""A camera's path in the colours of its frames' statuses."""

from collections.abc import Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from idfslam.frame import Status

STATUS_COLOURS = {  # RGB, 0 to 255
    Status.OK: (90, 200, 120),
    Status.DEGENERATE: (240, 180, 60),
    Status.DOUBTFUL: (240, 120, 40),
    Status.LOST: (235, 70, 60),
    Status.INTERPOLATED: (200, 120, 230),
}


def coloured_strips(positions: NDArray[np.float64], statuses: Sequence[Status]) -> tuple[list[NDArray[np.float64]], list[Status]]:
    """Cuts the path through positions (N, 3) where the status changes. Each strip has one status and begins where the last one ends."""
    strips, kinds, first = [], [], 0
    for status, group in groupby(statuses):
        end = first + len(list(group))
        strips.append(positions[max(first - 1, 0) : end])
        kinds.append(status)
        first = end
    return strips, kinds
