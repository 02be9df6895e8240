"""Members that lie evenly over a sequence, such as some frames of a recording."""

import numpy as np
from numpy.typing import NDArray


def evenly_spread(length: int, count: int) -> NDArray[np.int64]:
    """Indices (M,) of `count` members of a sequence of `length`, both ends among them; all of them, if there are fewer."""
    if length <= 0:
        return np.empty(0, np.int64)
    return np.unique(np.linspace(0, length - 1, min(count, length)).round().astype(np.int64))
