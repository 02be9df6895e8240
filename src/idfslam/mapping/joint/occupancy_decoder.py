"""NICE-SLAM's decoders: small networks from the features of a grid at a point to occupancy or colour (Zhu et al. 2022, Sec. 3.1 and 4)."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from idfslam.mapping.joint.fourier_features import FourierFeatures

_SKIP = 2  # layer after which the input is added once more: a fact of the published network


class GridDecoder(nn.Module):
    """Layers of a position's Fourier features, to each of which the grid's features are added. The position enters once more half way."""

    def __init__(self, features: int, outputs: int, *, width: int, blocks: int, frequencies: int, deviation: float) -> None:
        super().__init__()
        self.embedding = FourierFeatures(frequencies, deviation)
        inputs = [frequencies, *[width] * (blocks - 1)]
        if blocks > _SKIP + 1:
            inputs[_SKIP + 1] += frequencies
        self.layers = nn.ModuleList(nn.Linear(i, width) for i in inputs)
        self.features = nn.ModuleList(nn.Linear(features, width) for _ in range(blocks))
        self.output = nn.Linear(width, outputs)
        initialise(self.layers)

    def forward(self, points: Tensor, features: Tensor) -> Tensor:
        """Points (N, 3) [m], features (N, F) -> (N, outputs)."""
        hidden = embedded = self.embedding(points)
        for i, (layer, of_grid) in enumerate(zip(self.layers, self.features)):
            hidden = F.relu(layer(hidden)) + of_grid(features)
            if i == _SKIP:
                hidden = torch.cat([embedded, hidden], -1)
        return self.output(hidden)


class CoarseDecoder(nn.Module):
    """Layers of the grid's features alone: the coarse level does not know the position."""

    def __init__(self, features: int, *, width: int, blocks: int) -> None:
        super().__init__()
        inputs = [features, *[width] * (blocks - 1)]
        if blocks > _SKIP + 1:
            inputs[_SKIP + 1] += features
        self.layers = nn.ModuleList(nn.Linear(i, width) for i in inputs)
        self.output = nn.Linear(width, 1)
        initialise(self.layers)

    def forward(self, points: Tensor, features: Tensor) -> Tensor:
        """Points (N, 3) [m], which play no part, and features (N, F) -> (N, 1)."""
        hidden = features
        for i, layer in enumerate(self.layers):
            hidden = F.relu(layer(hidden))
            if i == _SKIP:
                hidden = torch.cat([features, hidden], -1)
        return self.output(hidden)


def initialise(layers: nn.ModuleList) -> None:
    """Xavier's initialisation for ReLU, as in the published code."""
    for layer in layers:
        assert isinstance(layer, nn.Linear)
        nn.init.xavier_uniform_(layer.weight, gain=nn.init.calculate_gain("relu"))
        nn.init.zeros_(layer.bias)
