"""Self-supervised pretraining of the feature extractor on RGB-D recordings, without any pose (after UnsupervisedR&R [31]).

A pair of frames is registered by the features as they are; the other view's points, moved by that pose, should look like the image (colour,
depth), and matched points should meet. To these losses of [31] comes a contrastive one: where the registration explains the depth
images, it says which pixels see the same point, and their features should find each other among all pixels of the other image.
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor

from idfslam import __version__
from idfslam.errors import DivergedError, RecordingError
from idfslam.geometry import se3
from idfslam.hardware import resolve_precision
from idfslam.mapping.losses import correspondence_loss
from idfslam.tracking.contrastive import contrastive_loss, partners
from idfslam.tracking.features import FeatureExtractor
from idfslam.tracking.footage import Pair, Recording, View, augmented, load_footage, sample_pair
from idfslam.tracking.matching import Matches, match, spread
from idfslam.tracking.point_rendering import splat
from idfslam.tracking.registration import register


@dataclass(frozen=True)
class PretrainConfig:
    """How the extractor is pretrained."""

    height: int = 120
    """Rows that the frames are reduced to."""
    crop: tuple[int, int] = (96, 128)
    """Rows and columns of the random crop that a step trains on."""
    gap: int = 20
    """Frames of a pair lie at most this far apart; the first third of the steps grows towards it."""
    learning_rate: float = 1e-3
    """Adam's first rate, falling to zero along a half cosine ([31]: 1e-4, constant)."""
    weight_decay: float = 1e-6
    """Adam's weight decay [31]."""
    colour_weight: float = 0.0
    """Weight of the rendered colour's L1 ([31]: 1). In short runs the losses of [31] hold the contrastive one back (docs/model-card.md)."""
    depth_weight: float = 0.0
    """Weight of the rendered depth's L1 ([31]: 1)."""
    correspondence_weight: float = 0.0
    """Weight of the matched points' distance ([31]: 0.1)."""
    contrastive_weight: float = 1.0
    """Weight of the contrastive loss (not in [31])."""
    temperature: float = 0.07
    """Of the contrastive loss."""
    queries: int = 256
    """Pixels of each image that ask for their partner in the contrastive loss."""
    augmentation: float = 0.5
    """Strength of the changes of exposure, colour, noise and sharpness, from zero over the first third of the steps; 0: none."""
    matches: int = 400
    """K of the registration."""
    subsets: int = 10
    """Random subsets of 20 % that the rendered pose is the best of [31]."""
    inliers: float = 0.2
    """Share of the matches that a pose must explain before its correspondences are learnt."""
    agreement: float = 0.85
    """Share of overlapping depth pixels that it must explain too."""

    @property
    def rendered(self) -> bool:
        """Whether a loss of [31] takes part."""
        return max(self.colour_weight, self.depth_weight, self.correspondence_weight) > 0


def rendering_losses(T_ab: Tensor, a: View, b: View) -> tuple[Tensor, Tensor]:
    """L1 of colour and of depth [m] between view a and b's points drawn in it, means over what the points cover [31]."""
    valid = b.valid.flatten()
    points = se3.transform(T_ab.to(b.points), b.points.flatten(0, 1)[valid])
    drawn = splat(points, b.colour.flatten(1).mT[valid], a.camera)
    covered = drawn.coverage.detach()
    measured = covered * a.valid
    colour = (covered * (drawn.values - a.colour.permute(1, 2, 0)).abs().mean(-1)).sum() / covered.sum().clamp(min=1)
    depth = (measured * (drawn.depth - a.points[..., 2]).abs()).sum() / measured.sum().clamp(min=1)
    return colour, depth


def registered_pose(a: Tensor, b: Tensor, pair: Pair, config: PretrainConfig, generator: torch.Generator) -> Tensor | None:
    """T_ab (4, 4) by the robust registration of unit features a, b (C, h, w); None where too few matches support it."""
    matches = _correspondences(a, b, pair, config, mutual=True)
    if len(matches) < config.matches // 10:
        return None
    points_b, points_a = _matched_points(matches, pair)
    options = {"share": 0.03, "inlier_distance": 0.05, "truncation": 0.1}
    found = register(points_b, points_a, matches.weight, subsets=200, refits=3, generator=generator, **options)
    return found.T_ab if float(found.inliers.float().mean()) > config.inliers else None


def registration_losses(a: Tensor, b: Tensor, pair: Pair, config: PretrainConfig, generator: torch.Generator) -> dict[str, Tensor]:
    """The losses of [31] for unit features a, b (C, h, w): of colour and depth rendered at the pose they give, and of their matches."""
    matches = _correspondences(a, b, pair, config, mutual=False)
    if len(matches) < config.matches // 10:
        return {}
    points_b, points_a = _matched_points(matches, pair)
    found = register(points_b, points_a, matches.weight, subsets=config.subsets, share=0.2, inlier_distance=0.05, generator=generator)
    colour_a, depth_a = rendering_losses(found.T_ab, pair.a, pair.b)
    colour_b, depth_b = rendering_losses(se3.inverse(found.T_ab), pair.b, pair.a)
    apart = correspondence_loss(points_a.double(), points_b.double(), found.T_ab, matches.weight)
    return {"colour": (colour_a + colour_b) / 2, "depth": (depth_a + depth_b) / 2, "correspondence": apart}


def contrastive_losses(
    a: Tensor, b: Tensor, T_ab: Tensor, pair: Pair, config: PretrainConfig, generator: torch.Generator
) -> dict[str, Tensor]:
    """The contrastive loss of unit features a, b (C, h, w), both ways; nothing where T_ab does not explain the depth images."""
    losses = []
    for features, others, T, views in ((a, b, T_ab, pair), (b, a, se3.inverse(T_ab), Pair(pair.b, pair.a))):
        index, uv, agreement = partners(T, views.a, views.b)
        if agreement < config.agreement or len(index) < config.queries:
            return {}
        chosen = torch.randperm(len(index), generator=generator)[: config.queries].to(index.device)
        losses.append(contrastive_loss(others.flatten(1).mT[index[chosen]], features, uv[chosen], config.temperature))
    return {"contrastive": torch.stack(losses).mean()}


def _correspondences(a: Tensor, b: Tensor, pair: Pair, config: PretrainConfig, *, mutual: bool) -> Matches:
    found = match(b, a, pair.b.valid, pair.a.valid, query_stride=3, target_stride=2, mutual=mutual)
    return spread(found, (b.shape[1], b.shape[2]), limit=config.matches, grid=4)


def _matched_points(matches: Matches, pair: Pair) -> tuple[Tensor, Tensor]:
    return pair.b.points.flatten(0, 1)[matches.frame], pair.a.points.flatten(0, 1)[matches.keyframe]


def _features(extractor: FeatureExtractor, images: Sequence[Tensor]) -> Tensor:
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=resolve_precision("auto", torch.device("cpu")) is torch.bfloat16):
        features: Tensor = extractor(torch.stack(list(images)).contiguous(memory_format=torch.channels_last))
    return features.float()


def train_step(
    extractor: FeatureExtractor, pair: Pair, config: PretrainConfig, generator: torch.Generator, *, strength: float = 1.0
) -> dict[str, float]:
    """Gradients of the pair's weighted losses into the extractor; the losses by name.

    The images as they are give the pose whose correspondences are learnt; trained are the features of images augmented by `strength`.
    Raises DivergedError for a loss that is not finite.
    """
    views = (pair.a, pair.b)
    with torch.no_grad():
        a, b = _features(extractor, [view.colour for view in views])
        T_ab = registered_pose(a, b, pair, config, generator)
    a, b = _features(extractor, [augmented(view.colour, strength, generator) for view in views])
    losses = registration_losses(a, b, pair, config, generator) if config.rendered else {}
    losses |= contrastive_losses(a, b, T_ab, pair, config, generator) if T_ab is not None else {}
    for name, loss in losses.items():
        if not bool(loss.isfinite()):
            raise DivergedError(f"pretraining: the {name} loss is {float(loss)}; lower the learning rate")
    if losses:
        torch.stack([getattr(config, f"{name}_weight") * loss.double() for name, loss in losses.items()]).sum().backward()
    return {name: float(loss.detach()) for name, loss in losses.items()}


def pretrain(
    recordings: Sequence[Recording],
    *,
    out: Path,
    steps: int = 2400,
    seed: int = 0,
    config: PretrainConfig | None = None,
    report: Callable[[int, dict[str, float]], None] = lambda step, losses: None,
) -> None:
    """Trains an extractor from scratch on the recordings and writes its weights to `out` (safetensors, with how they were made).

    `report(step, losses)` is called after each step. Raises RecordingError for recordings without pairs, DivergedError for a loss that
    is not finite.
    """
    config = config or PretrainConfig()
    if not recordings:
        raise RecordingError("found no recordings, expected at least one to pretrain on; name their folders")
    footage = [load_footage(recording, config.height) for recording in recordings]
    began = time.perf_counter()
    torch.manual_seed(seed)
    generator = torch.Generator().manual_seed(seed)
    extractor = FeatureExtractor().train().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimiser = torch.optim.Adam(extractor.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for step in range(steps):
        ramp = min(1.0, 3 * step / steps)  # from near, clean pairs to far, changed ones: registration must work before it can teach
        gap = max(2, round(config.gap * (0.2 + 0.8 * ramp)))
        pair = sample_pair(footage, gap=gap, crop=config.crop, generator=generator)
        optimiser.zero_grad(set_to_none=True)
        losses = train_step(extractor, pair, config, generator, strength=ramp * config.augmentation)
        norm = torch.nn.utils.clip_grad_norm_(extractor.parameters(), 1.0)
        if bool(norm.isfinite()):  # two equal singular values in a Procrustes leave no gradient: that step is passed over
            optimiser.step()
        schedule.step()
        report(step, losses)
    _save(
        extractor, out, config, steps=steps, seed=seed, recordings=[r.name for r in recordings], seconds=round(time.perf_counter() - began)
    )


def _save(extractor: FeatureExtractor, out: Path, config: PretrainConfig, **made: object) -> None:
    """Weights as safetensors, with how they were made as its metadata (JSON)."""
    out.parent.mkdir(parents=True, exist_ok=True)
    state = {name: tensor.contiguous() for name, tensor in extractor.state_dict().items()}
    save_file(state, out, metadata={"made": json.dumps({**made, "idfslam": __version__}), "config": json.dumps(asdict(config))})
