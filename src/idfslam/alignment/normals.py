"""Normals of the map at a frame's points, smoothed over similar neighbours. Otherwise their noise looks like information along a wall."""

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from idfslam.compute.backend import pick

Floats = NDArray[np.float32]

# [1] Least cosine between normals that are averaged (25 degrees). More: less smoothing, sharper edges. Chosen by hand.
_SIMILAR = 0.906
# [m] Largest distance of a neighbour from the tangent plane. More: averages reach over small steps. Chosen by hand.
_COPLANAR = 0.03
# [patches] Neighbours to each side. More: smoother. Without smoothing, a bare wall has 15 times too much information along it; with 2,
# little (docs/findings.md).
_REACH = 2


def smoothed_normals(points: Tensor, gradient: Tensor, patches: Tensor) -> tuple[Tensor, Tensor]:
    """Unit normals (N, 3) from the gradient (N, 3) of the distance at points (N, 3) [m], and the gradient's length (N,).

    A normal is the mean of the similar normals in the 5 x 5 `patches` around it: those within 25 degrees whose points lie within 3 cm of
    its tangent plane. The normals of a wall learnt from noisy depth are off by several degrees, which looks like information along the
    wall. Edges stay sharp.
    """
    return pick(points, compiled=compiled_smoothed_normals, plain=plain_smoothed_normals)(points, gradient, patches)


def compiled_smoothed_normals(points: Tensor, gradient: Tensor, patches: Tensor) -> tuple[Tensor, Tensor]:
    """`smoothed_normals` by Numba, on the CPU."""
    normal, slope = fill_smoothed_normals(points.numpy(), gradient.numpy(), patches.numpy())
    return torch.from_numpy(normal), torch.from_numpy(slope)


def fill_smoothed_normals(points: Floats, gradient: Floats, patches: NDArray[np.int32]) -> tuple[Floats, Floats]:
    """The same of arrays."""
    from idfslam.alignment.kernels import numba_depth

    normal, slope = np.empty_like(gradient), np.empty(len(gradient), np.float32)
    limits = _REACH, np.float32(_SIMILAR), np.float32(_COPLANAR)
    numba_depth.smoothed_normals(points, gradient, patches, *limits, normal, slope)  # type: ignore[call-arg]
    return normal, slope


def plain_smoothed_normals(points: Tensor, gradient: Tensor, patches: Tensor) -> tuple[Tensor, Tensor]:
    """`smoothed_normals` in torch, on any device."""
    slope = gradient.norm(dim=-1)
    return plain_smoothed(points, gradient / slope.clamp(min=1e-9)[:, None], patches), slope


def plain_smoothed(points: Tensor, unit: Tensor, patches: Tensor) -> Tensor:
    """The smoothed normals (N, 3) alone, from unit gradients (N, 3)."""
    rows, columns = patches.shape
    padded = F.pad(patches.long(), (_REACH,) * 4, value=-1)
    here, filled = patches.clamp(min=0).long(), patches >= 0
    total = torch.zeros(rows, columns, 3, dtype=unit.dtype, device=unit.device)
    for i in range(2 * _REACH + 1):
        for j in range(2 * _REACH + 1):
            there = padded[i : i + rows, j : j + columns]
            n, other = unit[here], unit[there.clamp(min=0)]
            off = (n * (points[there.clamp(min=0)] - points[here])).sum(-1)
            similar = (there >= 0) & ((n * other).sum(-1) >= _SIMILAR) & (off.abs() < _COPLANAR)
            total += other * similar[..., None]
    return F.normalize(total[filled], dim=-1)[patches[filled].long().argsort()]
