"""The implicit map: one network from a position to T-SDF and colour (Sec. IV, Fig. 3)."""

import copy
import math
from collections.abc import Iterator, Mapping
from typing import TypeVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from idfslam.config import FieldConfig
from idfslam.mapping.encodings import PositionalEncoding
from idfslam.mapping.grid import GridEncoding
from idfslam.mapping.surface_field import SurfaceField

AnyField = TypeVar("AnyField", bound=SurfaceField)


class Field(SurfaceField):
    """Encoding, trunk, and two heads: T-SDF in units of the truncation distance, colour in [0, 1].

    It does not depend on rays or cameras. With a feature grid, the field is about +1 (free space) wherever it has not learnt yet.
    """

    representation = "neural_field"

    def __init__(self, config: FieldConfig, *, bf16: bool = False) -> None:
        super().__init__()
        self.config, self.bf16 = config, bf16
        self.encoding = GridEncoding(config) if config.encoding == "grid" else PositionalEncoding(config.position_frequencies)
        self.direction_encoding = PositionalEncoding(config.direction_frequencies) if config.direction_frequencies else None
        widths = [self.encoding.out_dim] + [config.width] * config.layers
        inputs = [w + (self.encoding.out_dim if i == config.skip - 1 and i > 0 else 0) for i, w in enumerate(widths[:-1])]
        self.trunk = nn.ModuleList(nn.Linear(i, config.width) for i in inputs)
        self.sdf_head = nn.Linear(config.width, 1)
        seen = config.width + (self.direction_encoding.out_dim if self.direction_encoding else 0)
        self.colour_head = nn.Sequential(nn.Linear(seen, config.colour_width), nn.ReLU(), nn.Linear(config.colour_width, 3))
        self._initialise()

    def _initialise(self) -> None:
        for layer in self.modules():
            if isinstance(layer, nn.Linear):
                nn.init.kaiming_uniform_(layer.weight, a=math.sqrt(5) if layer.out_features < 8 else 0, nonlinearity="relu")
                nn.init.zeros_(layer.bias)
        if self.config.encoding == "grid":
            nn.init.ones_(self.sdf_head.bias)

    def trunk_features(self, points: Tensor) -> Tensor:
        """Points (N, 3) [m] -> features (N, width) that both heads read."""
        encoded = hidden = self.encoding(points)
        for i, layer in enumerate(self.trunk):
            if i == self.config.skip - 1 and i > 0:
                hidden = torch.cat([hidden, encoded], -1)
            hidden = F.relu(layer(hidden))
        return hidden

    def forward(self, points: Tensor, directions: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Points (N, 3) [m], view directions (N, 3) of any length -> T-SDF (N,) in units of tr, colour (N, 3)."""
        with torch.autocast(points.device.type, torch.bfloat16, enabled=self.bf16):
            hidden = self.trunk_features(points)
            sdf = self.sdf_head(hidden)
            if self.direction_encoding is not None:
                if directions is None:
                    raise ValueError("this field's colour depends on the view direction: pass directions")
                hidden = torch.cat([hidden, self.direction_encoding(F.normalize(directions, dim=-1))], -1)
            colour = torch.sigmoid(self.colour_head(hidden))
        return sdf.to(points.dtype)[:, 0], colour.to(points.dtype)

    def sdf(self, points: Tensor) -> Tensor:
        """Points (N, 3) [m] -> T-SDF (N,) in units of tr."""
        with torch.autocast(points.device.type, torch.bfloat16, enabled=self.bf16):
            return self.sdf_head(self.trunk_features(points)).float()[:, 0]

    @property
    def finest_cells(self) -> float | None:
        return self.config.finest if self.config.encoding == "grid" else None


def grids_of(field: SurfaceField) -> Iterator[tuple[str, GridEncoding]]:
    """The feature grids of a field, by their names in its state."""
    return ((name, module) for name, module in field.named_modules() if isinstance(module, GridEncoding))


def copy_of(field: AnyField) -> AnyField:
    """A copy of a field with frozen parameters."""
    other = copy.deepcopy(field).requires_grad_(False)
    for _, grid in grids_of(other):
        grid.replace(grid.tables.detach())  # the copied tables are not on huge pages (`roomy_zeros`)
    return other


def load_field(field: SurfaceField, weights: Mapping[str, Tensor]) -> None:
    """Loads the weights of a field of the same config. The tables of its grids may have another size."""
    for name, grid in grids_of(field):
        if weights[f"{name}.tables"].shape != grid.tables.shape:
            grid.replace(weights[f"{name}.tables"].clone())
    for name, buffer in list(field._buffers.items()):  # marks of the entries of tables
        if buffer is not None and name in weights and weights[name].shape != buffer.shape:
            setattr(field, name, torch.zeros_like(weights[name], device=buffer.device))
    field.load_state_dict(weights)
