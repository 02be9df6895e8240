"""The nearest layer of a depth image, by Otsu's threshold (1979) on inverse depth."""

import numpy as np
from numpy.typing import NDArray

_LAYER = 0.04, 0.7  # [1] least and largest share of the nearest layer. Wider: smaller and larger bodies are found. Chosen by hand


def nearest_layer(depth: NDArray[np.float32]) -> NDArray[np.bool_] | None:
    """The near part (h, w) of depth (h, w) [m], split where the parts differ most (Otsu 1979, inverse depth); None: too small or large."""
    measured = depth > 0
    inverse = np.sort(1 / depth[measured])
    if len(inverse) < 2:
        return None
    count, total = np.arange(1, len(inverse)), inverse.cumsum()
    below, above = total[:-1] / count, (total[-1] - total[:-1]) / (len(inverse) - count)
    best = int((count * (len(inverse) - count) * (above - below) ** 2).argmax())
    layer = measured & (depth < 1 / inverse[best])
    return layer if _LAYER[0] <= layer.mean() <= _LAYER[1] else None
