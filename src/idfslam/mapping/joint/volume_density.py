"""iMAP's map: one network from a position to colour and volume density (Sucar et al. 2021, Sec. 3.1)."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from idfslam.config import VolumeDensityConfig
from idfslam.mapping.joint.fourier_features import FourierFeatures
from idfslam.mapping.occupancy_rendering import OccupancyField, occupancy_of_density

# [1/m] Density everywhere at first, about: rays then pass through a room. More: they end close to the camera, and depth is learnt later.
# Chosen by hand.
_FIRST_DENSITY = 0.2


class VolumeDensity(OccupancyField):
    """Fourier features, a trunk that receives them again at its third layer, and one head for colour and density.

    The surface is where the density makes `truncation` of a ray half opaque.
    """

    representation = "volume_density"

    def __init__(self, config: VolumeDensityConfig, *, bf16: bool = False) -> None:
        super().__init__()
        self.config, self.bf16 = config, bf16
        self.encoding = FourierFeatures(config.features, config.deviation, config.unit)
        inputs = [config.features, *[config.width] * (config.layers - 1)]
        if config.layers > 2:
            inputs[2] += config.features  # concatenated to the second activation
        self.trunk = nn.ModuleList(nn.Linear(i, config.width) for i in inputs)
        self.head = nn.Linear(config.width, 4)
        for layer in self.trunk:
            assert isinstance(layer, nn.Linear)
            nn.init.kaiming_uniform_(layer.weight, nonlinearity="relu")
            nn.init.zeros_(layer.bias)
        nn.init.constant_(self.head.bias[3:], math.log(math.expm1(_FIRST_DENSITY / config.density_scale)))

    def density(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Points (N, 3) [m] -> volume density (N,) [1/m], colour (N, 3) in [0, 1]."""
        encoded = self.encoding(points)  # in full precision: half a millimetre of a position is lost otherwise
        with torch.autocast(points.device.type, torch.bfloat16, enabled=self.bf16):
            hidden = encoded
            for i, layer in enumerate(self.trunk):
                hidden = F.relu(layer(torch.cat([hidden, encoded.to(hidden.dtype)], -1) if i == 2 else hidden))
            out = self.head(hidden).to(points.dtype)
        return self.config.density_scale * F.softplus(out[:, 3]), torch.sigmoid(out[:, :3])

    def occupancy(self, points: Tensor, steps: Tensor) -> tuple[Tensor, Tensor]:
        density, colour = self.density(points)
        return occupancy_of_density(density, steps), colour

    def forward(self, points: Tensor, directions: Tensor | None = None) -> tuple[Tensor, Tensor]:
        density, colour = self.density(points)
        return self._level(density), colour

    def sdf(self, points: Tensor) -> Tensor:
        return self._level(self.density(points)[0])

    def _level(self, density: Tensor) -> Tensor:
        """1 in empty space, 0 where `truncation` of a ray is half opaque, -1 in solid matter."""
        return (2 * torch.exp(-density * self.config.truncation) - 1).clamp(-1, 1)
