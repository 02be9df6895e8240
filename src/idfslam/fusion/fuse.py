"""Depth images with poses fused into one volume."""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from idfslam.compute.ahead import ahead
from idfslam.fusion.constants import BLOCK
from idfslam.fusion.integration import Voxels, integrate
from idfslam.fusion.prepared_depth import prepared
from idfslam.fusion.smoothing import denoised
from idfslam.fusion.tsdf_volume import STEPS, TsdfVolume
from idfslam.geometry.blocks import touched_blocks
from idfslam.geometry.depth_view import DepthView

Item = TypeVar("Item")

_TRUNCATION = 3.0  # [voxels] More: noise is averaged farther from the surface, thin things are filled. Chosen by hand
_MARGIN = 2.0  # [voxels] from readings up to which there are blocks. More: more of them, slower. Chosen by hand
_STRIDE = 2  # [px] of the readings that blocks are made near. More: faster, and far surfaces have holes without blocks. Chosen by hand
# [m] Error of the network's surface where fused distances are uncertain: at edges, far away, at grazing views. It is compared with theirs.
# More: the network counts less. Chosen on generated rooms
_OF_NETWORK = 0.015
_LEVELS = 15  # of trust above 0, a divisor of 255. More: larger files (with 255, a sixth of the map's). Chosen by hand
_LEAST_NUMBER = 1000  # deviations that a block's scatter needs. More: fewer blocks tell the noise. Chosen by hand


def fuse(views: Sequence[DepthView], voxel: float, most_blocks: int, readings: Iterable[DepthView] | None = None) -> TsdfVolume:
    """The volume of views, in voxels of `voxel` [m], or of larger ones where it would have more than `most_blocks` blocks.

    readings: the depth images that are fused, if they are others than the views, which then only tell where blocks are needed. The first
    ones that see a block count. Memory: 4 kB a block, and one image of `readings`.
    """
    voxel, blocks = _allocated(views, voxel, most_blocks)
    voxels = Voxels.empty(voxel, _TRUNCATION * voxel, blocks)
    for view in ahead(prepared, in_random_order(views) if readings is None else readings):
        integrate(voxels, view)
    return finished(voxels)


def in_random_order(views: Sequence[Item]) -> Iterator[Item]:
    """The same views from all of a run, since a block takes the first ones that see it."""
    return (views[i] for i in np.random.default_rng(0).permutation(len(views)))


def finished(voxels: Voxels) -> TsdfVolume:
    """The volume of the voxels: smoothed and trusted by the variance of each distance."""
    seen = voxels.weight > 0
    variance = variance_factor(voxels) / np.where(seen, voxels.weight, 1)
    distance = denoised(voxels.blocks, voxels.distance, variance, seen)
    certain = np.float32(_OF_NETWORK**2) / (variance + np.float32(_OF_NETWORK**2))
    trust = (np.rint(np.where(seen, certain, 0) * _LEVELS) * (255 // _LEVELS)).astype(np.uint8)
    steps = np.rint(np.where(trust > 0, distance, 0) * np.float32(STEPS / voxels.truncation)).astype(np.int16)  # zeros: a small file
    return TsdfVolume(voxels.voxel, voxels.truncation, voxels.blocks, steps, trust)


def variance_factor(voxels: Voxels) -> np.float32:
    """The variance of distances over what the sensor's model says: the median over blocks; 1 where too few images tell it.

    Without noise it is nearly 0; errors of poses and calibration raise it.
    """
    squares, number = voxels.scatter.T
    told = number >= _LEAST_NUMBER
    return np.float32(np.median(squares[told] / number[told])) if told.any() else np.float32(1)


def _allocated(views: Sequence[DepthView], voxel: float, most: int) -> tuple[float, NDArray[np.int64]]:
    """The edge of a voxel [m], and the blocks (M, 3) near readings: at most `most`."""
    while True:
        blocks = touched_blocks(views, BLOCK * voxel, _MARGIN * voxel, stride=_STRIDE)
        if len(blocks) <= most:
            return voxel, blocks
        voxel *= max(math.sqrt(len(blocks) / most), 1.05)
