"""NICE-SLAM's map: feature grids of four levels, with decoders of occupancy and colour (Zhu et al. 2022, Sec. 3.1).

No bounds of the scene are known here, so each level is a hash table over unbounded space (`GridEncoding`), which grows, and not an array.
"""

from collections.abc import Callable
from enum import Enum
from importlib.resources import as_file, files
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from idfslam.config import FieldConfig, OccupancyGridsConfig
from idfslam.errors import ConfigError
from idfslam.mapping.grid import GridEncoding
from idfslam.mapping.joint.occupancy_decoder import CoarseDecoder, GridDecoder
from idfslam.mapping.occupancy_rendering import OccupancyField

_SHARPNESS = 10.0  # [1] factor on a decoder's output before the sigmoid: a fact of the published network
# [1] Standard deviation of first features, of the fine level and of the others (NICE-SLAM's code). More: surfaces appear where none is.
_FINE_DEVIATION, _DEVIATION = 1e-4, 1e-2
# Powers of two by which the tables of the middle and coarse level are smaller: their cells are larger. Less: more memory, less sharing
_MIDDLE_SMALLER, _COARSE_SMALLER = 2, 6
LEVELS = ("coarse", "middle", "fine", "colour")
PRETRAINED = ("coarse_decoder", "middle_decoder", "fine_decoder")


class LearningStage(Enum):
    """Which levels take part: they are learnt from coarse to fine (NICE-SLAM, Sec. 3.3)."""

    COARSE = "coarse"  # the coarse level alone, which predicts what was not seen
    MIDDLE = "middle"
    FINE = "fine"  # the middle level, and what the fine one adds to it
    COLOUR = "colour"  # the same, with colours


class OccupancyGrids(OccupancyField):
    """Occupancy is sigmoid(10 (middle + fine)); `sdf` is 1 - 2 occupancy, so the surface is where occupancy is one half."""

    representation = "occupancy_grids"

    def __init__(self, config: OccupancyGridsConfig) -> None:
        super().__init__()
        self.config = config
        cells = {"coarse": config.coarse, "middle": config.middle, "fine": config.fine, "colour": config.colour}
        smaller = {"coarse": _COARSE_SMALLER, "middle": _MIDDLE_SMALLER}
        for level, cell in cells.items():
            log2 = max(config.table_log2 - smaller.get(level, 0), 1)
            grid = GridEncoding(FieldConfig(levels=1, coarsest=cell, finest=cell, features=config.features, table_log2=log2))
            with torch.no_grad():
                grid.tables.normal_(0, _FINE_DEVIATION if level == "fine" else _DEVIATION)
            setattr(self, level, grid)
            self.register_buffer(f"{level}_used", torch.zeros(2**log2, dtype=torch.bool))
        self.coarse_decoder = CoarseDecoder(config.features, width=config.width, blocks=config.blocks)
        shape = {"width": config.width, "blocks": config.blocks, "frequencies": config.frequencies}
        self.middle_decoder = GridDecoder(config.features, 1, deviation=config.deviation, **shape)
        self.fine_decoder = GridDecoder(2 * config.features, 1, deviation=config.deviation, **shape)
        self.colour_decoder = GridDecoder(config.features, 3, deviation=config.deviation, **shape)

    def grid(self, level: str) -> GridEncoding:
        """The grid of a level."""
        grid = getattr(self, level)
        assert isinstance(grid, GridEncoding)
        return grid

    @property
    def finest_cells(self) -> float | None:
        return self.config.fine

    def occupancy(
        self,
        points: Tensor,
        steps: Tensor,
        stage: LearningStage = LearningStage.COLOUR,
        learnable: Callable[[Tensor], Tensor] | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Occupancy (N,) and, in the stage `COLOUR`, colour (N, 3) at points (N, 3) [m]; the lengths play no part.

        learnable: points -> (N,) bool, where features may collect a gradient. None: everywhere.
        """
        collects = learnable(points)[:, None] if learnable is not None else None

        def features(level: str) -> Tensor:
            found: Tensor = self.grid(level)(points)
            return found if collects is None else torch.where(collects, found, found.detach())

        colour = torch.zeros_like(points)
        if stage is LearningStage.COARSE:
            return self._sigmoid(self.coarse_decoder(points, features("coarse"))), colour
        middle = features("middle")
        logit = self.middle_decoder(points, middle)
        if stage is not LearningStage.MIDDLE:
            logit = logit + self.fine_decoder(points, torch.cat([features("fine"), middle.detach()], -1))
        if stage is LearningStage.COLOUR:
            colour = self.colour_decoder(points, features("colour"))
        return self._sigmoid(logit), colour

    @staticmethod
    def _sigmoid(logit: Tensor) -> Tensor:
        return torch.sigmoid(_SHARPNESS * logit[:, 0])

    def forward(self, points: Tensor, directions: Tensor | None = None) -> tuple[Tensor, Tensor]:
        occupancy, colour = self.occupancy(points, points)
        return 1 - 2 * occupancy, colour.clamp(0, 1)

    def sdf(self, points: Tensor) -> Tensor:
        return 1 - 2 * self.occupancy(points, points, LearningStage.FINE)[0]

    @torch.no_grad()
    def mark_used(self, level: str, entries: Tensor) -> None:
        """Marks entries (S,) bool of a level's table as used. If too many are, the table is doubled; the map stays the same function."""
        used: Tensor = getattr(self, f"{level}_used")
        used |= entries
        grid, c = self.grid(level), self.config
        if float(used.float().mean()) > c.table_load and grid.tables.shape[1] < 2**c.table_log2_max:
            grid.double_tables()
            setattr(self, f"{level}_used", torch.zeros(grid.tables.shape[1], dtype=torch.bool, device=used.device))

    def load_decoders(self, path: Path | None = None) -> None:
        """Loads the pretrained decoders of occupancy: the shipped ones without a path. Raises ConfigError if they do not fit."""
        if path is None:
            with as_file(files("idfslam.mapping") / "weights" / "occupancy_decoders.safetensors") as shipped:
                return self.load_decoders(shipped)
        try:
            weights = load_file(path)
            for name in PRETRAINED:
                mine = {key.removeprefix(f"{name}."): value for key, value in weights.items() if key.startswith(f"{name}.")}
                getattr(self, name).load_state_dict(mine)
        except (OSError, RuntimeError, SafetensorError) as error:
            reason = " ".join(str(error).split())[:200]
            expected = "decoders of the size that occupancy_grids states; train some, or use the shipped size"
            raise ConfigError(f"{path}: {reason}; expected {expected}") from error
        return None


def levels_of(stage: LearningStage) -> tuple[str, ...]:
    """The levels whose features a stage reads."""
    return {LearningStage.COARSE: ("coarse",), LearningStage.MIDDLE: ("middle",), LearningStage.FINE: ("middle", "fine")}.get(
        stage, ("middle", "fine", "colour")
    )
