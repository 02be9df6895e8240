"""Random changes of a training view, as they occur between two images of one place: light, sensor, focus, and holes in the depth."""

from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional as F

from idfslam.pretraining.footage import PairView

_HOLES = 6  # at most, at full strength; each up to a third of the image's height wide and high; more: less depth to learn from


def augmented(view: PairView, strength: float, generator: torch.Generator) -> PairView:
    """The view with random exposure, gamma, white balance, noise and holes in its depth, sometimes blurred. strength: 0 to 1."""
    return replace(view, colour=_retaken(view.colour, strength, generator), points=_with_holes(view.points, strength, generator))


def _retaken(colour: Tensor, strength: float, generator: torch.Generator) -> Tensor:
    """The colours (3, h, w) as another camera might have recorded them."""

    def draw(*size: int) -> Tensor:
        return strength * (2 * torch.rand(*size, generator=generator) - 1)

    out = colour.clamp(min=1e-4) ** torch.exp(0.3 * draw(1)) * torch.exp(0.3 * draw(1) + 0.1 * draw(3))[:, None, None]
    out = out + 0.1 * draw(1)
    if float(draw(1)) > 0.4:
        out = F.avg_pool2d(out[None], 3, 1, 1, count_include_pad=False)[0]
    return (out + 0.03 * draw(1).abs() * torch.randn(out.shape, generator=generator)).clamp(0, 1)


def _with_holes(points: Tensor, strength: float, generator: torch.Generator) -> Tensor:
    """Points (h, w, 3) with random elliptical holes, like those that depth cameras leave on black, shiny and distant surfaces."""
    height, width = points.shape[:2]
    v, u = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    lost = torch.zeros(height, width, dtype=torch.bool)
    for _ in range(round(_HOLES * strength * float(torch.rand(1, generator=generator)))):
        centre, size = torch.rand(2, generator=generator), 1 + height / 6 * torch.rand(2, generator=generator)
        lost |= ((v - centre[0] * height) / size[0]) ** 2 + ((u - centre[1] * width) / size[1]) ** 2 < 1
    return points.masked_fill(lost[..., None], 0.0)
