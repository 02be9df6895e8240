"""Losses as numbers, for the log: a loss that is not finite ends the run."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from idfslam.errors import DivergedError


def loss_values(losses: Mapping[str, Tensor], where: str, advice: str) -> dict[str, float]:
    """Losses, scalars on one device, as numbers by name.

    Raises DivergedError if one is not finite: `where` says of which frame it is, and `advice` what to do.
    """
    numbers = dict(zip(losses, torch.stack([loss.detach() for loss in losses.values()]).tolist()))
    for name, value in numbers.items():
        if not math.isfinite(value):
            raise DivergedError(f"{where}: the {name} loss is {value}; {advice}")
    return numbers
