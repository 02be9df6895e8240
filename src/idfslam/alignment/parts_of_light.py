"""The gains of parts of an image, each estimated together with the part's displacement: generalised optical flow (Negahdaripour,
"Revised definition of optical flow: integration of radiometric and geometric cues for dynamic scene analysis", 1998).

Where a few landmarks, or those on one edge, tell both, the displacement explains their differences and the gain stays that of the image.
Nor does a gain change by more than light alone would explain. The compiled form is in `kernels/light.py`.
"""

import torch
from torch import Tensor

from idfslam.alignment.constants import LARGEST_CHANGE, LEAST_CHANGE, LEAST_DIFFERENCE, OUTLYING, UNMOVED


def changes(part: Tensor, columns: Tensor, difference: Tensor, weight: Tensor, parts: int, unchanged: float) -> Tensor:
    """(parts, 3) change of light [1] and displacement [px] of each part, from what landmarks expect of these, columns (M, 3).

    unchanged: the number of landmarks that say that the light of a part is that of the image.
    """
    H = columns.new_zeros(parts, 3, 3).index_add_(0, part, weight[:, None, None] * columns[:, :, None] * columns[:, None])
    b = columns.new_zeros(parts, 3).index_add_(0, part, (weight * difference)[:, None] * columns)
    count = weight.new_zeros(parts).index_add_(0, part, weight).clamp(min=1e-9)
    of_light, displaced = unchanged * H[:, 0, 0] / count, UNMOVED * (H[:, 1, 1] + H[:, 2, 2]) / count
    ridge = torch.diag_embed(torch.stack([of_light, displaced, displaced], -1) + 1e-9)
    H = H + ridge
    alone = (b[:, :1] / H[:, :1, 0]).clamp(LEAST_CHANGE - 1, LARGEST_CHANGE - 1)
    light = torch.linalg.solve(H, b)[:, :1].clamp(alone.clamp(max=0), alone.clamp(min=0))
    rest = b[:, 1:] - H[:, 1:, 0] * light
    return torch.cat([light, torch.linalg.solve(H[:, 1:, 1:], rest)], -1)


def weights(part: Tensor, left: Tensor, parts: int) -> Tensor:
    """(M,) robust weights by what the change of its part does not explain of a landmark's brightness, over the mean of the part."""
    total, count = (left.new_zeros(parts).index_add_(0, part, x) for x in (left.abs(), torch.ones_like(left)))
    return 1 / (1 + (left / (OUTLYING * total / count + LEAST_DIFFERENCE)[part]) ** 2) ** 2
