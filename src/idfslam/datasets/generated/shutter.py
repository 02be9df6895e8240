"""Rolling shutters: the rows of an image are exposed one after the other."""

import numpy as np
from numpy.typing import NDArray

_READOUT = 0.020, 0.030  # [s] from the first row to the last; raised, fast motion shears images more. Those of common colour cameras


def drawn_readouts(seed: int, strength: float) -> tuple[float, float]:
    """[s] of the colour camera and of the depth camera of a recording with this seed."""
    colour, depth = np.random.default_rng([seed, 53]).uniform(*_READOUT, 2) * strength
    return float(colour), float(depth)


def row_times(timestamp: float, readout: float, rows: int) -> NDArray[np.float64]:
    """[s] when each row is exposed, (H,), as `SensorTiming` defines it; (1,) for all rows of a global shutter."""
    if readout == 0:
        return np.array([timestamp])
    return timestamp + readout * ((np.arange(rows) + 0.5) / rows - 0.5)
