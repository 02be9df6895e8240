"""A volume that has seen a plane."""

from collections.abc import Iterable

import numpy as np

from idfslam.fusion.constants import BLOCK
from idfslam.fusion.tsdf_volume import STEPS, TsdfVolume


def plane_volume(z: float, columns: Iterable[int], trust: int = 255) -> TsdfVolume:
    """The plane at height z [m], in free space below it, in blocks around it at x and y in `columns`; voxels of 1 cm."""
    voxel, truncation, across = 0.01, 0.04, list(columns)
    layer = round(z / voxel) // BLOCK
    blocks = np.array([(i, j, k) for i in across for j in across for k in (layer - 1, layer, layer + 1)], np.int64)
    height = (blocks[:, 2, None] * BLOCK + np.arange(BLOCK)) * voxel
    steps = np.rint(np.clip((z - height) / truncation, -1, 1) * STEPS).astype(np.int16)
    distance = np.broadcast_to(steps[:, None, None], (len(blocks), BLOCK, BLOCK, BLOCK)).copy()
    return TsdfVolume(voxel, truncation, blocks, distance, np.full_like(distance, trust, np.uint8))
