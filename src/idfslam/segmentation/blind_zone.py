"""The blind zone of a depth sensor: holes in a view that show a body which is nearer than the sensor reads.

Such a body has no depth, so no free space tells of it. But it came from where it could be read, and still can at its rim: the hole
touches near cells that move, or the hole that it made in the view before.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.segmentation.constants import NEVER

Cells = NDArray[np.bool_]
Ages = NDArray[np.int32]

# [m] depth of a moving cell at whose side a hole shows the same body. More: holes beside bodies that are farther away are masked. Chosen
# by hand: structured light is read from 0.4 to 0.6 m on
_NEAR = 0.8
_AROUND = np.ones((5, 5), np.uint8)  # [cells] at whose middle a hole touches what is within. Larger: rims that were missed hinder less


def blind(depth: NDArray[np.float32], moving: Cells, before: Ages) -> Ages:
    """(h, w) [frames] how long ago each hole of depth (h, w) [m] touched a near body that moves (h, w); `NEVER` in all other cells.

    before: the same of the view before, at most a few cells away.
    """
    beside = np.where(before < NEVER, before + 1, NEVER).astype(np.int32)
    beside[moving & (depth > 0) & (depth < _NEAR)] = 0
    if (beside == NEVER).all() or (depth > 0).all():
        return np.full(depth.shape, NEVER, np.int32)
    touched = cv2.erode(beside.astype(np.float64), _AROUND).astype(np.int32)  # the youngest around
    count, labels = cv2.connectedComponents((depth <= 0).astype(np.uint8))
    hole = np.asarray(labels, np.int32)
    age = np.full(count, NEVER, np.int32)
    np.minimum.at(age, hole, touched)
    age[0] = NEVER  # all that has depth
    return age[hole]
