"""A volume as tensors of a file: distances as differences between neighbouring voxels, which compress well."""

import zlib

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.fusion.constants import BLOCK
from idfslam.fusion.tsdf_volume import STEPS, TsdfVolume

_LEVEL = 6  # of zlib, as is its default. More: slower, hardly smaller


def tensors_of(volume: TsdfVolume) -> dict[str, Tensor]:
    """`blocks` (M, 3) int32, and the bytes of `low`, `high` and `trust`, compressed with zlib.

    Low and high bytes (M, B, B, B) are those of the differences of distance along the last axis, modulo 2^16.
    """
    steps = volume.distance.view(np.uint16).copy()
    steps[..., 1:] -= volume.distance.view(np.uint16)[..., :-1]
    planes = {"low": (steps & 255).astype(np.uint8), "high": (steps >> 8).astype(np.uint8), "trust": volume.trust}
    return {"blocks": torch.from_numpy(volume.blocks.astype(np.int32)), **{name: _packed(plane) for name, plane in planes.items()}}


def volume_of(tensors: dict[str, Tensor], voxel: float, truncation: float) -> TsdfVolume:
    """The inverse of `tensors_of`. Raises ValueError if the tensors make no volume, KeyError if one is missing."""
    blocks = tensors["blocks"].numpy()
    if blocks.ndim != 2 or blocks.shape[1] != 3 or blocks.dtype != np.int32:
        raise ValueError(f"volume.blocks is {blocks.shape} {blocks.dtype}, expected (M, 3) int32")
    if not (0 < voxel < np.inf and 0 < truncation < np.inf):
        raise ValueError(f"a volume in voxels of {voxel} m with a truncation of {truncation} m")
    low, high, trust = (_unpacked(tensors[name], len(blocks), name) for name in ("low", "high", "trust"))
    steps = low.astype(np.uint16) | (high.astype(np.uint16) << 8)
    distance = np.cumsum(steps, axis=-1, dtype=np.uint16).view(np.int16)
    if len(distance) and np.abs(distance).max() > STEPS:
        raise ValueError(f"a distance of {np.abs(distance).max()} steps, expected at most {STEPS}")
    return TsdfVolume(voxel, truncation, blocks.astype(np.int64), distance, trust)


def _packed(plane: NDArray[np.uint8]) -> Tensor:
    return torch.from_numpy(np.frombuffer(zlib.compress(plane.tobytes(), _LEVEL), np.uint8).copy())


def _unpacked(tensor: Tensor, blocks: int, name: str) -> NDArray[np.uint8]:
    """Bytes (M, BLOCK, BLOCK, BLOCK). Never more than these are unpacked."""
    size = blocks * BLOCK**3
    unpacker = zlib.decompressobj()
    try:
        data = unpacker.decompress(tensor.numpy().tobytes(), size + 1)
    except zlib.error as error:
        raise ValueError(f"volume.{name} is damaged: {error}") from error
    if len(data) != size:
        raise ValueError(f"volume.{name} has other than {size} bytes")
    return np.frombuffer(data, np.uint8).reshape(blocks, BLOCK, BLOCK, BLOCK).copy()
