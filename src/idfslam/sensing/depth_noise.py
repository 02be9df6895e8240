"""How noisy a depth reading is: structured light and stereo lose with the square of depth (Nguyen et al., 3DIMPVT 2012)."""

from torch import Tensor

BEST = 0.0012  # [m] standard deviation of a structured-light camera's reading at 0.4 m, its best (Nguyen et al. 2012)


def noise_ratio(depth: Tensor) -> Tensor:
    """Noise of readings at `depth` [m] as a multiple of the sensor's best [1]."""
    return 1 + 1.5 * (depth - 0.4).clamp(min=0) ** 2


def difference_noise(depth: Tensor) -> Tensor:
    """Standard deviation [m] of the difference of two readings at `depth` [m]."""
    return 2**0.5 * BEST * noise_ratio(depth)
