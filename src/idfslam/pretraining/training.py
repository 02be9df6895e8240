"""One step of self-supervised training on a pair of frames, without any pose (after UnsupervisedR&R [31]).

The present features register the pair. The losses of [31] require that the other view's points, moved by that pose, look like this view
(colour and depth), and that matched points coincide. A contrastive loss is added: if the pose agrees with both depth images, it says which
pixels see the same point, and the features of these pixels should be most similar among all pixels.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from idfslam.compute.devices import resolve_precision
from idfslam.config import PretrainConfig
from idfslam.errors import DivergedError
from idfslam.geometry import se3
from idfslam.pretraining.augmentation import augmented
from idfslam.pretraining.contrastive import contrastive_loss
from idfslam.pretraining.footage import Pair, PairView
from idfslam.pretraining.point_rendering import splat
from idfslam.tracking.features import FeatureExtractor
from idfslam.tracking.finetuning import correspondence_loss
from idfslam.tracking.matching import PixelMatches, bucket, features_in, match
from idfslam.tracking.overlap import Overlap, overlapping_pixels
from idfslam.tracking.procrustes import random_subsets, register

# Matching. All were chosen by hand
_QUERY_STRIDE, _TARGET_STRIDE = 3, 2  # [px] of the pixels that are matched, and of those that they are matched with. More: faster, coarser
_GRID = 4  # cells along each side of the image that share the matches. More: matches spread more evenly
_FEWER = 10  # a pair with fewer than one of so many wanted matches teaches nothing. More: fewer matches are enough
_INLIER_DISTANCE = 0.05  # [m] distance of matched points up to which they support a pose. More: worse poses pass

# The pose of the contrastive loss, which must be right. All were chosen by hand
_POSE_SUBSETS, _POSE_SHARE = (
    200,
    0.03,
)  # subsets of matches, and the share of the matches in each. More: slower; larger: more outliers in each
_TRUNCATION = 0.1  # [m] distance from which all outliers count the same. More: outliers count more
_REFITS = 3  # on all inliers. More: slower, more exact

_LOSS_SHARE = 0.2  # [1] share of the matches in a subset whose pose has a loss. More: smoother losses, fewer right poses. Chosen by hand


def rendering_losses(T_ab: Tensor, a: PairView, b: PairView) -> tuple[Tensor, Tensor]:
    """L1 of colour and depth [m] between view a and the points of b rendered in it at T_ab (4, 4), averaged over covered pixels [31]."""
    valid = b.valid.flatten()
    points = se3.transform(T_ab.to(b.points), b.points.flatten(0, 1)[valid])
    drawn = splat(points, b.colour.flatten(1).mT[valid], a.camera)
    covered = drawn.coverage.detach()
    measured = covered * a.valid
    colour = (covered * (drawn.values - a.colour.permute(1, 2, 0)).abs().mean(-1)).sum() / covered.sum().clamp(min=1)
    depth = (measured * (drawn.depth - a.points[..., 2]).abs()).sum() / measured.sum().clamp(min=1)
    return colour, depth


def registered_pose(a: Tensor, b: Tensor, pair: Pair, config: PretrainConfig, generator: torch.Generator) -> Tensor | None:
    """T_ab (4, 4) by robust registration of unit features a, b (C, h, w); None if too few matches support it."""
    matches = _correspondences(a, b, pair, config, mutual=True)
    if len(matches) < config.matches // _FEWER:
        return None
    points_b, points_a = _matched_points(matches, pair)
    subsets = random_subsets(len(matches), subsets=_POSE_SUBSETS, share=_POSE_SHARE, generator=generator)
    found = register(points_b, points_a, matches.weight, subsets, inlier_distance=_INLIER_DISTANCE, truncation=_TRUNCATION, refits=_REFITS)
    return found.T_ab if float(found.inliers.float().mean()) > config.inliers else None


def registration_losses(a: Tensor, b: Tensor, pair: Pair, config: PretrainConfig, generator: torch.Generator) -> dict[str, Tensor]:
    """The losses of [31] for unit features a, b (C, h, w): colour and depth rendered at their registered pose, and matched points."""
    matches = _correspondences(a, b, pair, config, mutual=False)
    if len(matches) < config.matches // _FEWER:
        return {}
    points_b, points_a = _matched_points(matches, pair)
    subsets = random_subsets(len(matches), subsets=config.subsets, share=_LOSS_SHARE, generator=generator)
    found = register(points_b, points_a, matches.weight, subsets, inlier_distance=_INLIER_DISTANCE)
    colour_a, depth_a = rendering_losses(found.T_ab, pair.a, pair.b)
    colour_b, depth_b = rendering_losses(se3.inverse(found.T_ab), pair.b, pair.a)
    apart = correspondence_loss(points_a.double(), points_b.double(), found.T_ab, matches.weight)
    return {"colour": (colour_a + colour_b) / 2, "depth": (depth_a + depth_b) / 2, "correspondence": apart}


def explained(T_ab: Tensor, pair: Pair, config: PretrainConfig) -> tuple[Overlap, Overlap] | None:
    """What each view's pixels see of the other at T_ab (4, 4), b's in a and a's in b; None where the depth images contradict it."""
    both = overlapping_pixels(T_ab, pair.a, pair.b), overlapping_pixels(se3.inverse(T_ab), pair.b, pair.a)
    enough = all(found.depth_consistency >= config.agreement and len(found.index) >= config.queries for found in both)
    return both if enough else None


def contrastive_losses(
    a: Tensor, b: Tensor, T_ab: Tensor, pair: Pair, config: PretrainConfig, generator: torch.Generator
) -> dict[str, Tensor]:
    """The contrastive loss of unit features a, b (C, h, w), both ways; nothing where T_ab does not explain the depth images."""
    seen = explained(T_ab, pair, config)
    if seen is None:
        return {}
    losses = []
    for features, others, found in ((a, b, seen[0]), (b, a, seen[1])):
        chosen = torch.randperm(len(found.index), generator=generator)[: config.queries].to(found.index.device)
        losses.append(contrastive_loss(others.flatten(1).mT[found.index[chosen]], features, found.uv[chosen], config.temperature))
    return {"contrastive": torch.stack(losses).mean()}


def _correspondences(a: Tensor, b: Tensor, pair: Pair, config: PretrainConfig, *, mutual: bool) -> PixelMatches:
    found = match(
        features_in(b), features_in(a), pair.b.valid, pair.a.valid, query_stride=_QUERY_STRIDE, target_stride=_TARGET_STRIDE, mutual=mutual
    )
    return bucket(found, (b.shape[1], b.shape[2]), limit=config.matches, grid=_GRID)


def _matched_points(matches: PixelMatches, pair: Pair) -> tuple[Tensor, Tensor]:
    return pair.b.points.flatten(0, 1)[matches.frame], pair.a.points.flatten(0, 1)[matches.keyframe]


def features_of(extractor: FeatureExtractor, images: Sequence[Tensor], config: PretrainConfig) -> Tensor:
    """Unit features (N, C, h, w) float32 of N images (3, h, w), computed in the config's precision."""
    device = images[0].device
    with torch.autocast(device.type, torch.bfloat16, enabled=resolve_precision(config.precision, device) is torch.bfloat16):
        features: Tensor = extractor(torch.stack(list(images)).contiguous(memory_format=torch.channels_last))
    return features.float()


def train_step(
    extractor: FeatureExtractor, pair: Pair, config: PretrainConfig, generator: torch.Generator, *, strength: float = 1.0
) -> dict[str, float]:
    """Adds the gradients of the pair's weighted losses, divided by the batch size, to the extractor's. Returns the losses by name.

    The pose for the contrastive loss comes from the unchanged images. The losses are those of the views augmented by `strength`.
    Raises DivergedError for a loss that is not finite.
    """
    device = next(extractor.parameters()).device
    changed = Pair(*(augmented(view, strength, generator) for view in (pair.a, pair.b))).to(device)
    pair = pair.to(device)
    with torch.no_grad():
        a, b = features_of(extractor, [pair.a.colour, pair.b.colour], config)
        T_ab = registered_pose(a, b, pair, config, generator)
    a, b = features_of(extractor, [changed.a.colour, changed.b.colour], config)
    losses = registration_losses(a, b, changed, config, generator) if config.rendered else {}
    losses |= contrastive_losses(a, b, T_ab, changed, config, generator) if T_ab is not None else {}
    for name, loss in losses.items():
        if not bool(loss.isfinite()):
            raise DivergedError(f"pretraining: the {name} loss is {float(loss)}; lower --learning-rate")
    if losses:
        weighted = [getattr(config, f"{name}_weight") * loss.double() for name, loss in losses.items()]
        (torch.stack(weighted).sum() / config.batch).backward()
    return {name: float(loss.detach()) for name, loss in losses.items()}
