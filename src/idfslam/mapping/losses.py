"""The losses of the map and of the keyframe poses (Eqs. 1-4).

Units. The field's T-SDF is in units of the truncation distance tr. Free-space residuals T_s - tr are in that unit (target 1), truncation
residuals are in metres. This is so in [25]. The paper does not give its weights; the defaults here are those of [25] (0.1, 10, 6000).

Form. The printed equations take L2 norms, which for a scalar is its absolute value. [25], to which the paper refers for its loss, squares
them, and so does this code. As in the published code of [25], the free-space loss and the truncation loss are each multiplied by the other
class's share of the samples (the balance). This factor is in neither paper's equations.

Measured error of the first zero crossing, median and mean, after 400 steps of an MLP of 3 x 128 on a room with a ball in it (48 samples a
ray, sharpness 10, one seed): squared with balance 0.3, 0.6 cm; squared without balance 0.4, 0.6 cm; printed norms without balance 0.1,
2.8 cm; printed norms with balance 119, 124 cm. In the last case free space has too little weight against 6000, and false surfaces stay in
front of the camera.
"""

from dataclasses import dataclass

from torch import Tensor

from idfslam.mapping.tsdf_rendering import Rendered


@dataclass(frozen=True)
class LossWeights:
    """Weights of Eqs. 2 and 3."""

    photometric: float = 0.1  # w_p
    free_space: float = 10.0  # w_fs, on units of tr
    truncation: float = 6000.0  # w_tr, on metres


@dataclass(frozen=True)
class Losses:
    """The loss of a step (`total`), its parts before weighting, and each ray's loss for active sampling."""

    total: Tensor  # () Eq. 3
    photometric: Tensor  # () Eq. 1
    free_space: Tensor  # () Eq. 2 [tr^2]
    truncation: Tensor  # () Eq. 2 [m^2]
    per_ray: Tensor  # (B,) detached; their mean is `total`


def photometric_residuals(colour: Tensor, target: Tensor) -> Tensor:
    """The terms of Eq. 1: squared norms (B,) of the differences between colours (B, 3)."""
    difference = colour - target
    return (difference * difference).sum(-1)


def geometric_residuals(sdf: Tensor, depths: Tensor, target_depth: Tensor, truncation: float) -> tuple[Tensor, Tensor, Tensor]:
    """The terms of Eq. 2, as means over each ray's samples: free space (B,) [tr^2], truncation (B,) [m^2]; and the share of S^fs.

    sdf (B, S) [tr], depths (B, S) [m], target_depth (B,) [m]. S^fs are the samples in front of the truncation region, where T should be tr.
    S^tr are the samples within tr of the measured depth, where T should be the measured depth minus the sample's. A ray without a sample in
    a class, or without depth (0), has the term 0. The share of S^fs is among all samples of both classes.
    """
    distance = target_depth[:, None] - depths  # [m], positive before the surface
    measured = target_depth[:, None] > 0
    free = (measured & (distance > truncation)).to(sdf.dtype)
    near = (measured & (distance.abs() <= truncation)).to(sdf.dtype)
    free_residual = (sdf - 1) * free
    near_residual = (sdf * truncation - distance) * near
    free_mean = free_residual.square().sum(1) / free.sum(1).clamp(min=1)
    near_mean = near_residual.square().sum(1) / near.sum(1).clamp(min=1)
    return free_mean, near_mean, free.sum() / (free.sum() + near.sum()).clamp(min=1)


def _weighted(photometric: Tensor, free_space: Tensor, truncation: Tensor, free_share: Tensor, weights: LossWeights) -> Losses:
    """Eq. 3 from per-ray terms (B,)."""
    geometric = weights.free_space * (1 - free_share) * free_space + weights.truncation * free_share * truncation
    per_ray = geometric + weights.photometric * photometric
    return Losses(per_ray.mean(), photometric.mean(), free_space.mean(), truncation.mean(), per_ray.detach())


def rendering_losses(
    rendered: Rendered, target_colour: Tensor, target_depth: Tensor, truncation: float, weights: LossWeights | None = None
) -> Losses:
    """Eqs. 1-3 of B rendered rays against colours (B, 3) and depths (B,) [m]. A ray without a reading (0) has a colour loss alone."""
    weights = weights or LossWeights()
    photometric = photometric_residuals(rendered.colour, target_colour)
    free_space, near, free_share = geometric_residuals(rendered.sdf, rendered.depths, target_depth, truncation)
    return _weighted(photometric, free_space, near, free_share, weights)
