"""The losses of iMAP and NICE-SLAM on rendered rays: L1 of colour and depth, with and without the weight of the depth's variance."""

from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.mapping.occupancy_rendering import RenderedRays

_LEAST_VARIANCE = 1e-10  # [m^2] added to the variance, so that no weight is infinite (NICE-SLAM's code). More: sure depths weigh less


@dataclass(frozen=True)
class RayLosses:
    """The loss of a step, its parts before weighting, and what active sampling draws by."""

    total: Tensor  # ()
    photometric: Tensor  # () mean over the rays
    depth: Tensor  # () mean over the rays [1] if it is weighted by the deviation, else [m]
    per_ray: Tensor  # (B,) e_p + e_g, detached (iMAP, Eq. 10)


def photometric_errors(rendered: RenderedRays, colour: Tensor) -> Tensor:
    """e_p (B,): L1 norms of the differences to colours (B, 3)."""
    return (rendered.colour - colour).abs().sum(-1)


def depth_errors(rendered: RenderedRays, depth: Tensor) -> Tensor:
    """e_g (B,) [m]: distances to depths (B,) [m]; 0 for a ray without a reading (0)."""
    return (rendered.depth - depth).abs() * (depth > 0)


def variance_weighted_loss(rendered: RenderedRays, colour: Tensor, depth: Tensor, weight: float, *, outliers: float = 0.0) -> RayLosses:
    """L_g + weight L_p, with the mean of e_g over the rendered depth's deviation as L_g (iMAP, Eqs. 6-8; NICE-SLAM, Eqs. 11 and 12).

    outliers: rays whose e_g over the deviation is more than this many times the median are left out, and so are those without a reading
    (NICE-SLAM, Sec. 3.4). 0: all rays count. No gradient flows through the deviation: a loss must not fall because a depth becomes unsure.
    """
    e_p, e_g = photometric_errors(rendered, colour), depth_errors(rendered, depth)
    weighted = e_g / (rendered.variance.detach() + _LEAST_VARIANCE).sqrt()
    kept = torch.ones_like(weighted)
    if outliers and bool((depth > 0).any()):
        kept = ((depth > 0) & (weighted <= outliers * weighted[depth > 0].median())).to(weighted)
    photometric, geometric = (e_p * kept).mean(), (weighted * kept).mean()
    return RayLosses(geometric + weight * photometric, photometric, geometric, (e_p + e_g).detach())


def depth_and_colour_loss(rendered: RenderedRays, colour: Tensor, depth: Tensor, weight: float) -> RayLosses:
    """L_g + weight L_p of means without weights of variance (NICE-SLAM, Eqs. 8-10)."""
    e_p, e_g = photometric_errors(rendered, colour), depth_errors(rendered, depth)
    return RayLosses(e_g.mean() + weight * e_p.mean(), e_p.mean(), e_g.mean(), (e_p + e_g).detach())
