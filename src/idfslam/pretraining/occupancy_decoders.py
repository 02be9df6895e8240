"""Training of the occupancy decoders of `--map-representation occupancy_grids` on generated rooms.

NICE-SLAM takes its decoders from a convolutional occupancy network, whose encoder fills the grids. Here there is no encoder: the features
of a room are optimised from scratch with the decoders, as they are in SLAM (an auto-decoder, Park et al. 2019). Each episode begins with
new features in a room that is turned and shifted at random, so the decoders learn to be moved by features, and not where rooms stand.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from safetensors.torch import save
from torch import Tensor

from idfslam.config import OccupancyGridsConfig
from idfslam.datasets.generated.room import TOUR, SyntheticRoom
from idfslam.geometry import se3
from idfslam.mapping.joint.occupancy_grids import LEVELS, PRETRAINED, OccupancyGrids
from idfslam.storage.safetensors_file import ordered

log = logging.getLogger(__name__)

# All were chosen by hand.
_SIZE = 80, 60  # [px] of the views. More: finer shapes, and more time for rendering
_BEHIND = 0.2  # [m] behind a reading up to which space counts as occupied. More: thicker walls, thin things swell
_NEAR = 0.08  # [1] reach around a reading of the points near the surface, over the depth. More: coarser, and more free space
_SHIFT = 5.0  # [m] largest shift of a room along each axis. More: positions tell less
_RATES = {"coarse": 0.01, "middle": 0.1, "fine": 0.01}  # of the features; that of the middle level falls to a tenth after half an episode
_SHARPNESS = 10.0  # [1] factor on the logit, that of `OccupancyGrids`: a fact of the network


@dataclass(frozen=True)
class DecoderTraining:
    """The values of a training."""

    rooms: tuple[int, ...] = (101, 102, 103)  # seeds of generated rooms
    views: int = 16  # of each room, evenly along its tour
    episodes: int = 30
    steps: int = 50  # of an episode
    points: int = 1024  # of a step
    window: int = 4  # neighbouring views that an episode learns
    learning_rate: float = 2e-3  # of the decoders; it falls to zero along a half cosine
    seed: int = 0


@dataclass(frozen=True)
class DecoderView:
    """Readings (N,) [m] of one view, and the rays (N, 3) with z = 1 through them, at pose T_wc (4, 4)."""

    depth: Tensor
    rays: Tensor
    T_wc: Tensor


def views_of(seed: int, count: int) -> list[DecoderView]:
    """`count` views of a generated room, evenly along its tour."""
    room = SyntheticRoom(seed, width=_SIZE[0], height=_SIZE[1])
    found = []
    for index in np.linspace(0, TOUR - 1, count).astype(int):
        depth = torch.from_numpy(room[int(index)].depth)
        rays = room.camera.rays(room.camera.pixels())
        found.append(DecoderView(depth[depth > 0], rays[depth > 0], torch.from_numpy(room.ground_truth[index]).float()))
    return found


def labelled_points(views: Sequence[DecoderView], T: Tensor, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Points (N, 3) [m], moved by T (4, 4), and whether each is occupied (N,): a quarter in free space, the rest around readings."""
    each = count // len(views)
    points, labels = [], []
    for view in views:
        i = torch.randint(len(view.depth), (each,), generator=generator)
        chance = torch.rand(each, generator=generator)
        depth, free = view.depth[i], torch.arange(each) % 4 == 0
        near = depth + (2 * chance - 1) * torch.minimum(_NEAR * depth, torch.tensor(_BEHIND))
        along = torch.where(free, chance * depth, near)
        points.append(se3.transform(T @ view.T_wc, view.rays[i] * along[:, None]))
        labels.append(along > depth)
    return torch.cat(points), torch.cat(labels).float()


def train(training: DecoderTraining, config: OccupancyGridsConfig | None = None) -> tuple[OccupancyGrids, list[float]]:
    """Trains the decoders; returns a map with them, and the mean loss of each episode. One seed gives one result."""
    torch.manual_seed(training.seed)
    generator = torch.Generator().manual_seed(training.seed)
    field = OccupancyGrids(replace(config or OccupancyGridsConfig(), table_log2=13))
    rooms = [views_of(seed, training.views) for seed in training.rooms]
    decoders = [getattr(field, name) for name in PRETRAINED]
    outer = torch.optim.Adam([p for decoder in decoders for p in decoder.parameters()], lr=training.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(outer, training.episodes * training.steps)
    losses = []
    for episode in range(training.episodes):
        room = rooms[episode % len(rooms)]
        first = int(torch.randint(len(room), (), generator=generator))
        window = [room[(first + i) % len(room)] for i in range(training.window)]
        losses.append(_episode(field, window, outer, schedule, training, generator))
        log.info("episode %d of %d: loss %.4f", episode + 1, training.episodes, losses[-1])
    return field, losses


def _episode(
    field: OccupancyGrids,
    window: Sequence[DecoderView],
    outer: torch.optim.Adam,
    schedule: torch.optim.lr_scheduler.LRScheduler,
    training: DecoderTraining,
    generator: torch.Generator,
) -> float:
    """Learns new features of a window from scratch, and moves the decoders at each step; returns the mean loss."""
    first_features(field, generator)
    T = random_transform(generator)
    grids = {level: field.grid(level) for level in _RATES}
    inner = torch.optim.Adam([{"params": [grid.tables], "lr": _RATES[level]} for level, grid in grids.items()])
    total = 0.0
    for step in range(training.steps):
        inner.param_groups[1]["lr"] = _RATES["middle"] * (1.0 if step < training.steps // 2 else 0.1)
        outer.zero_grad()
        for grid in grids.values():
            grid.gradient.zero_()
            grid.tables.grad = grid.gradient
        points, occupied = labelled_points(window, T, training.points, generator)
        loss = _loss(field, points, occupied)
        loss.backward()
        outer.step()
        inner.step()
        schedule.step()
        total += float(loss.detach()) / training.steps
    return total


def _loss(field: OccupancyGrids, points: Tensor, occupied: Tensor) -> Tensor:
    """The cross-entropies of the coarse and the middle level, and of the middle and fine ones together."""
    middle_features = field.grid("middle")(points)
    middle = field.middle_decoder(points, middle_features)[:, 0]
    fine = field.fine_decoder(points, torch.cat([field.grid("fine")(points), middle_features.detach()], -1))[:, 0]
    coarse = field.coarse_decoder(points, field.grid("coarse")(points))[:, 0]
    logits = torch.stack([coarse, middle, middle.detach() + fine])
    return F.binary_cross_entropy_with_logits(_SHARPNESS * logits, occupied.expand(3, -1)) * 3


@torch.no_grad()
def first_features(field: OccupancyGrids, generator: torch.Generator) -> None:
    """Draws new features of all levels, as at the start of a run."""
    for level in LEVELS:
        tables = field.grid(level).tables
        deviation = 1e-4 if level == "fine" else 1e-2
        tables.copy_(torch.randn(tables.shape, generator=generator) * deviation)


def random_transform(generator: torch.Generator) -> Tensor:
    """A random rotation and a shift of at most 5 m along each axis, (4, 4)."""
    turn = torch.nn.functional.normalize(torch.randn(3, generator=generator), dim=0) * torch.rand((), generator=generator) * torch.pi
    T = se3.exp(torch.cat([torch.zeros(3), turn]))
    T[:3, 3] = (2 * torch.rand(3, generator=generator) - 1) * _SHIFT
    return T


def save_decoders(path: Path, field: OccupancyGrids, training: DecoderTraining) -> None:
    """Writes the pretrained decoders as safetensors, with the values of the training as metadata."""
    weights = {name: value.contiguous() for name, value in field.state_dict().items() if name.split(".")[0] in PRETRAINED}
    path.write_bytes(ordered(save(weights, {name: str(value) for name, value in vars(training).items()})))
