"""A rendered image at the exposure of a recorded one.

The map has the exposure of the first keyframe, so the two cannot be compared as they are.
"""

import numpy as np
from numpy.typing import NDArray

_LEAST_SPREAD = 1e-6  # [1] least variance of a channel; more: images of one colour keep their contrast. Chosen by hand


def matched_exposure(rendered: NDArray[np.floating], recorded: NDArray[np.floating], counts: NDArray[np.bool_]) -> NDArray[np.float32]:
    """`rendered` (H, W, 3) with the gain and the offset of each channel that bring it closest to `recorded`, within [0, 1].

    counts (H, W): the pixels that are compared. Without any the image stays as it is.
    """
    out = np.asarray(rendered, np.float32).copy()
    for channel in range(3) if counts.any() else ():
        x, y = rendered[..., channel][counts].astype(np.float64), recorded[..., channel][counts].astype(np.float64)
        gain = float(((x - x.mean()) * (y - y.mean())).mean()) / max(float(x.var()), _LEAST_SPREAD)
        out[..., channel] = gain * (out[..., channel] - x.mean()) + y.mean()
    return np.clip(out, 0, 1)
