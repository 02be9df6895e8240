"""Regions grown from seeds: over neighbouring cells of about the same depth, as long as nothing says that they stay."""

import numpy as np
from numpy.typing import NDArray

from idfslam.segmentation.plain_form import form

Cells = NDArray[np.bool_]

# All of them were chosen by hand on generated rooms.
_FRIENDS = 3  # seeds of eight neighbours that a seed must have. More: smaller things are missed, and less noise is taken for a thing
REACH = 8  # [cells] from a seed that a region grows. More: whole bodies in space that no view knows, and more of the floor with them
# [m], and per metre of depth: largest step to a neighbour of the same body. More: bodies merge with what is behind
_JUMP, _SLOPE = 0.03, 0.02
# [cells] of a region that must be seeds. More: small things are missed, and less noise is taken for a thing. On redkitchen, where nothing
# moves, 23 regions had 4 to 16; in freiburg1_rpy, with 24, 38 of the first 100 frames had false masks, with 32 to 48 ten. Of what people's
# regions covered in a generated room, those with fewer than 24 had 1 %.
_LEAST = 32


def grown(seeds: Cells, stays: Cells, depth: NDArray[np.float32], reach: int = REACH) -> Cells:
    """(h, w) the regions around seeds (h, w). They spread over cells of depth (h, w) [m] that do not stay, by `reach` cells."""
    from idfslam.segmentation.kernels import numba_segmentation

    out = np.zeros(seeds.shape, np.bool_)
    form(numba_segmentation.grow)(seeds, stays, depth, _FRIENDS, reach, np.float32(_JUMP), np.float32(_SLOPE), out)
    nothing, anywhere = np.zeros_like(out), (np.zeros_like(depth), np.float32(np.inf))
    form(numba_segmentation.drop_regions)(out, seeds, nothing, *anywhere, True, _LEAST, 0.0)
    return out
