"""Online finetuning of the out-conv to the scene (Sec. V-B): the losses of Eq. 6 for a pair of keyframes, and one step on them."""

from collections.abc import Callable

import torch
from torch import Tensor

from idfslam.compute.devices import repeatable
from idfslam.config import FinetuneConfig
from idfslam.errors import DivergedError
from idfslam.geometry.camera import Camera
from idfslam.tracking.frame_features import FrameFeatures
from idfslam.tracking.matching import PixelMatches

Render = Callable[[Camera, Tensor, Tensor], tuple[Tensor, Tensor]]
"""The frozen map as a recording's camera sees it from T_wc (4, 4) at pixels (B, 2) of its image: colour (B, 3), depth (B,) [m].

Differentiable in the pose.
"""


def depth_loss(depth: Tensor, target_depth: Tensor) -> Tensor:
    """Eq. 7: mean |D - D^| [m] over the rays (B,) that have a reading (target > 0); 0 if none has."""
    measured = target_depth > 0
    return ((depth - target_depth).abs() * measured).sum() / measured.sum().clamp(min=1)


def correspondence_loss(points_r: Tensor, points_c: Tensor, T_rc: Tensor, weights: Tensor) -> Tensor:
    """Eq. 8: mean of w ||p_r - T_rc p_c|| [m] over correspondences: points (C, 3) [m] of the two frames, weights (C,)."""
    aligned = points_c @ T_rc[:3, :3].mT + T_rc[:3, 3]
    return (weights * torch.linalg.vector_norm(points_r - aligned, dim=-1)).mean()


def finetuning_losses(
    current: FrameFeatures,
    reference: FrameFeatures,
    matches: PixelMatches,
    T_rc: Tensor,
    T_wr: Tensor,
    *,
    render: Render,
    pixels: int,
    generator: torch.Generator,
) -> dict[str, Tensor]:
    """The three losses of Eq. 6 for a pair of keyframes, rendered at T_wr @ T_rc, (4, 4) both, on `pixels` random pixels with depth."""
    points = current.points.flatten(0, 1)
    valid = current.valid.flatten().nonzero()[:, 0]
    chosen = valid[torch.randint(len(valid), (pixels,), generator=generator).to(valid.device)]
    uv, depth = current.source.project(points[chosen])
    colour, rendered = render(current.source, (T_wr.to(T_rc) @ T_rc).to(points.dtype), uv)
    points_r = reference.points.flatten(0, 1)[matches.keyframe]
    return {
        "photometric": torch.linalg.vector_norm(colour - current.colour.flatten(1).mT[chosen], dim=-1).mean(),  # Eq. 1
        "depth": depth_loss(rendered, depth),
        "correspondence": correspondence_loss(points_r.to(T_rc), points[matches.frame].to(T_rc), T_rc, matches.weight),
    }


def finetune_step(optimiser: torch.optim.Optimizer, losses: dict[str, Tensor], config: FinetuneConfig) -> dict[str, float]:
    """One step on the weighted sum of Eq. 6; returns the losses as numbers. Raises DivergedError, before the step, if one is not finite."""
    values = {name: float(loss.detach()) for name, loss in losses.items()}
    for name, value in values.items():
        if not torch.isfinite(torch.tensor(value)):
            raise DivergedError(
                f"finetuning: the {name} loss is {value}; lower --finetune.learning-rate or turn it off by --finetune.no-enabled"
            )
    weights = {"photometric": config.photometric_weight, "depth": config.depth_weight, "correspondence": config.correspondence_weight}
    total = torch.stack([weights[name] * loss.double() for name, loss in losses.items()]).sum()
    optimiser.zero_grad(set_to_none=True)
    with repeatable(total.device):
        total.backward()
    optimiser.step()
    return values
