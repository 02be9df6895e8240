"""How noisy a depth reading is: structured light and stereo lose with the square of depth (Nguyen et al., 3DIMPVT 2012)."""

from torch import Tensor

NEAREST = 0.4  # [m] depth of a reading at the sensor's best (Nguyen et al. 2012): nearer ones are no better; raised, more readings count
#    as the best
GROWTH = 1.5  # [1/m^2] of the noise with the square of the depth beyond, as a share of the best; raised, far readings count less
BEST = 0.0012  # [m] standard deviation of a structured-light camera's reading at 0.4 m (Nguyen et al. 2012); raised, all readings are
#    trusted less


def noise_ratio(depth: Tensor) -> Tensor:
    """Noise of readings at `depth` [m], of any shape, as a multiple of the sensor's best [1]."""
    return 1 + GROWTH * (depth - NEAREST).clamp(min=0) ** 2


def difference_noise(depth: Tensor) -> Tensor:
    """Standard deviation [m] of the difference of two readings at `depth` [m], of any shape."""
    return 2**0.5 * BEST * noise_ratio(depth)
