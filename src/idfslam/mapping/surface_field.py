"""What every map's field has in common, whatever it has learnt: a surface, and its colour."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import torch
from torch import Tensor, nn


class SurfaceField(nn.Module, ABC):
    """A field whose zero level is the surface: meshes, views and exports ask no more of a map.

    `sdf` is positive in front of the surface and within [-1, 1] away from it, in units of `config.truncation` [m]. For a field of signed
    distance it is that distance; for one of density or occupancy it is a monotone function of these, and at least has the sign.
    """

    representation: ClassVar[str]  # its name in `FIELDS` (`mapping/fields.py`), and in files of maps
    config: Any  # the section of the configuration that it was made from, with `truncation` [m]
    direction_encoding: nn.Module | None  # of the viewing direction, if colour depends on it
    bf16: bool = False  # whether its matrix products are computed in bf16

    def __init__(self) -> None:
        super().__init__()
        self.direction_encoding = None  # not of the class: it would hide the module that a field sets

    @abstractmethod
    def forward(self, points: Tensor, directions: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Points (N, 3) [m], view directions (N, 3) of any length -> `sdf` (N,), colour (N, 3) in [0, 1]."""

    @abstractmethod
    def sdf(self, points: Tensor) -> Tensor:
        """Points (N, 3) [m] -> (N,) in units of the truncation distance."""

    @contextmanager
    def learning(self) -> Iterator[None]:
        """A context in which its parameters collect gradients. Outside they are frozen, so queries cannot change the gradients."""
        self.requires_grad_(True)
        try:
            yield
        finally:
            self.requires_grad_(False)

    @property
    def finest_cells(self) -> float | None:
        """Edge [m] of the finest cells of its feature grid; None for a field without one."""
        return None

    def distance(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """`sdf` (N,) [m] at points (N, 3) [m] and its gradient (N, 3), by autograd. Parameters collect no gradient."""
        points = points.detach().requires_grad_(True)
        with torch.enable_grad():
            distance = self.sdf(points) * self.config.truncation
            (gradient,) = torch.autograd.grad(distance.sum(), points)
        return distance.detach(), gradient
