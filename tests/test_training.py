"""A step of pretraining: no pose anywhere in its data, augmentation, splats and losses by hand, and a few steps that learn."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates
from torch import Tensor

from idfslam.config import PretrainConfig
from idfslam.errors import FrameError, RecordingError
from idfslam.frame import Frame
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.pretraining.augmentation import augmented
from idfslam.pretraining.contrastive import contrastive_loss
from idfslam.pretraining.footage import Footage, FrameSequence, Pair, PairView, load_footage, sample_pair
from idfslam.pretraining.point_rendering import splat
from idfslam.pretraining.training import explained, registration_losses, rendering_losses, train_step
from idfslam.tracking.features import FeatureExtractor
from idfslam.tracking.overlap import overlapping_pixels

CAMERA = Camera(32, 24, 30.0, 30.0, 15.5, 11.5)
SMALL = PretrainConfig(height=24, crop=(24, 32), gap=2, queries=32, matches=100)  # the contrastive loss alone
ALL_LOSSES = replace(SMALL, colour_weight=1.0, depth_weight=1.0, correspondence_weight=0.1)  # with those of [31]
NOISE = np.random.default_rng(0).random((3, 40, 40))


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


class Wall:
    """A camera that slides along a textured wall at z = 1 m, 3 cm a frame."""

    name, camera = "wall", CAMERA

    def __init__(self, frames: int = 6, broken: int | None = None) -> None:
        self.frames, self.broken = frames, broken

    def __len__(self) -> int:
        return self.frames

    def __getitem__(self, index: int) -> Frame:
        if index == self.broken:
            raise FrameError(f"frame {index}: cannot be read")
        x, y = (CAMERA.rays(CAMERA.pixels()).numpy()[..., :2] + [0.03 * index, 0]).transpose(2, 0, 1)
        colour = np.stack([map_coordinates(noise, np.stack([y, x]) / 0.06 + 15, order=1) for noise in NOISE], -1)
        return Frame(index, 0.0, colour.astype(np.float32), np.ones((24, 32), np.float32), CAMERA)


def wall_pair(apart: int = 1) -> Pair:
    film = load_footage(Wall(), 24)
    return Pair(film.view(0, 0, 0, (24, 32)), film.view(apart, 0, 0, (24, 32)))


def test_training_data_carries_no_pose() -> None:
    # What a step is handed, and what it is made of: colour, points in each view's OWN frame, intrinsics. Nothing relates two frames.
    assert [field.name for field in fields(Pair)] == ["a", "b"]
    assert [field.name for field in fields(PairView)] == ["colour", "points", "camera"]
    assert [field.name for field in fields(Footage)] == ["colour", "depth", "camera"]
    assert [field.name for field in fields(Camera)] == ["width", "height", "fx", "fy", "cx", "cy"]
    assert not hasattr(FrameSequence, "ground_truth")


def test_a_recording_without_ground_truth_is_enough() -> None:
    assert load_footage(Wall(), 24).colour.shape == (6, 24, 32, 3)  # Wall has no poses to give


def test_a_crop_keeps_the_geometry() -> None:
    film = load_footage(Wall(), 24)
    whole, crop = film.view(0, 0, 0, (24, 32)), film.view(0, 5, 7, (10, 12))
    torch.testing.assert_close(crop.points, whole.points[5:15, 7:19])
    torch.testing.assert_close(crop.colour, whole.colour[:, 5:15, 7:19])


def test_a_broken_frame_is_blank() -> None:
    film = load_footage(Wall(broken=2), 24)
    assert film.depth[2].max() == 0
    assert film.depth[3].min() == 1000  # [mm]


def test_recordings_without_pairs() -> None:
    with pytest.raises(RecordingError, match="found 1 frames, expected at least two"):
        load_footage(Wall(frames=1), 24)


def test_pairs_are_near_and_in_both_orders() -> None:
    film = load_footage(Wall(), 24)
    shown = {film.colour[i].tobytes(): i for i in range(6)}
    drawn = generator()
    apart = []
    for _ in range(60):
        pair = sample_pair([film], gap=2, crop=(24, 32), generator=drawn)
        a, b = (shown[(view.colour.permute(1, 2, 0) * 255).round().to(torch.uint8).numpy().tobytes()] for view in (pair.a, pair.b))
        apart.append(b - a)
    assert set(apart) == {-2, -1, 1, 2}


def test_augmentation_keeps_the_range_and_can_be_off() -> None:
    view = wall_pair().a
    changed = augmented(view, 1.0, generator())
    assert 0 <= float(changed.colour.min()) <= float(changed.colour.max()) <= 1
    unchanged = augmented(view, 0.0, generator())
    torch.testing.assert_close(unchanged.colour, view.colour.clamp(min=1e-4))
    assert torch.equal(unchanged.points, view.points)


def test_augmentation_makes_holes_in_depth() -> None:
    # At full strength up to 6 ellipses, each of half axes up to 1 + 24/6 = 5 pixels, 79 pixels large: never more than 471 of the 768.
    views = [augmented(wall_pair().a, 1.0, generator(seed)) for seed in range(20)]
    lost = [int((~view.valid).sum()) for view in views]
    assert min(lost) == 0 < max(lost) <= 471
    assert all(bool((view.points[view.valid] == wall_pair().a.points[view.valid]).all()) for view in views)


def test_a_splat_by_hand() -> None:
    # A point at pixel (10, 5) exactly, z = 2: weight 1 in its pixel, 1 - 1/2.25 = 0.5556 beside it, 1 - 2/2.25 = 0.1111 in the corners.
    point = CAMERA.rays(torch.tensor([[10.0, 5.0]])) * 2
    drawn = splat(point, torch.tensor([[0.2, 0.4, 0.6]]), CAMERA)
    assert int((drawn.coverage > 0).sum()) == 9
    torch.testing.assert_close(drawn.coverage[4:7, 10], torch.tensor([0.5556, 1.0, 0.5556]), atol=1e-4, rtol=0)
    assert float(drawn.coverage[4, 9]) == pytest.approx(0.1111, abs=1e-4)
    torch.testing.assert_close(drawn.values[5, 11], torch.tensor([0.2, 0.4, 0.6]))
    assert float(drawn.depth[5, 10]) == pytest.approx(2.0)


def test_the_nearer_point_hides_the_other() -> None:
    # Same pixel, 1 m and 1.05 m: weights 1 and exp(-1) = 0.3679, depth (1 + 0.3679 * 1.05)/1.3679 = 1.01345; at 2 m the other is gone.
    ray = CAMERA.rays(torch.tensor([[10.0, 5.0]]))
    depth = [float(splat(torch.cat([ray, ray * z]), torch.zeros(2, 1), CAMERA).depth[5, 10]) for z in (1.05, 2.0)]
    assert depth == pytest.approx([1.01345, 1.0], abs=1e-4)


def test_points_behind_the_camera_are_not_drawn() -> None:
    assert float(splat(torch.tensor([[0.0, 0, -1]]), torch.ones(1, 3), CAMERA).coverage.max()) == 0


def test_a_splat_has_gradients_as_finite_differences() -> None:
    ray = CAMERA.rays(torch.tensor([[10.2, 5.1], [10.9, 5.8], [14.3, 9.2]], dtype=torch.float64))
    points = (ray * torch.tensor([[1.0], [1.02], [1.5]], dtype=torch.float64)).requires_grad_()
    values = torch.rand(3, 2, generator=generator(), dtype=torch.float64).requires_grad_()
    target = torch.rand(24, 32, generator=generator(1), dtype=torch.float64)

    def picture(points: Tensor, values: Tensor) -> Tensor:
        drawn = splat(points, values, CAMERA)
        return (drawn.values[..., 0] * target).sum() + (drawn.depth * target).sum()

    # The foremost depth of a pixel is held fixed in its exponential, so only the values and the sideways motion are exact.
    assert torch.autograd.gradcheck(lambda values: picture(points.detach(), values), (values,))
    (gradient,) = torch.autograd.grad(picture(points, values.detach()), points)
    step = torch.zeros_like(points)
    step[2, 0] = 1e-6  # the third point is alone in its pixels
    change = (picture(points.detach() + step, values.detach()) - picture(points.detach() - step, values.detach())) / 2e-6
    assert float(gradient[2, 0]) == pytest.approx(float(change), abs=1e-4)


def test_rendering_losses_prefer_the_true_pose() -> None:
    # The second view lies 3 cm to the right of the first: T_ab is a shift by +3 cm along x.
    pair = wall_pair()
    truth = se3.exp(torch.tensor([0.03, 0, 0, 0, 0, 0], dtype=torch.float64))
    colour, depth = rendering_losses(truth, pair.a, pair.b)
    wrong_colour, wrong_depth = rendering_losses(se3.exp(torch.tensor([-0.03, 0, 0.05, 0, 0, 0], dtype=torch.float64)), pair.a, pair.b)
    assert float(colour) < 0.5 * float(wrong_colour)
    assert float(depth) == pytest.approx(0, abs=1e-5)
    assert float(wrong_depth) == pytest.approx(0.05, abs=1e-4)  # the wall drawn 5 cm too deep


def test_overlap_by_hand() -> None:
    # f = 30 px, wall at 1 m, shift 3 cm: pixel u of b lies at u + 0.9 in a; columns 0..30 of 32 fall inside a (30.9 < 31.5), 31 does not.
    pair = wall_pair()
    truth = se3.exp(torch.tensor([0.03, 0, 0, 0, 0, 0], dtype=torch.float64))
    overlap = overlapping_pixels(truth, pair.a, pair.b)
    assert len(overlap.index) == 24 * 31
    torch.testing.assert_close(overlap.uv[:, 0], overlap.index % 32 + 0.9)
    assert overlap.depth_consistency == 1.0
    wrong = se3.exp(torch.tensor([0, 0, -0.2, 0, 0, 0], dtype=torch.float64))
    assert overlapping_pixels(wrong, pair.a, pair.b).depth_consistency == 0.0  # 20 cm in front of the measured wall
    assert explained(truth, pair, SMALL) is not None
    assert explained(wrong, pair, SMALL) is None


def test_contrastive_loss_by_hand() -> None:
    # Three features in a row, orthogonal; the query equals the middle one; temperature 1: logits (0, 1, 0). The Gaussian puts
    # exp(-1/0.98) = 0.3604 on the neighbours: shares 0.2094, 0.5812, 0.2094. -sum = log(2 + e) - 0.5812 = 1.5514 - 0.5812 = 0.9703.
    features = torch.eye(3)[:, None]  # (C = 3, H = 1, W = 3)
    loss = contrastive_loss(torch.eye(3)[1:2], features, torch.tensor([[1.0, 0.0]]), 1.0)
    assert float(loss) == pytest.approx(math.log(2 + math.e) - 1 / (1 + 2 * math.exp(-1 / 0.98)), abs=1e-5)


def test_registration_losses_reach_the_features() -> None:
    torch.manual_seed(0)
    pair = wall_pair()
    features = torch.nn.functional.normalize(torch.randn(2, 8, 24, 32, generator=generator()), dim=1).requires_grad_()
    losses = registration_losses(features[0], features[1], pair, ALL_LOSSES, generator())
    assert set(losses) == {"colour", "depth", "correspondence"}
    torch.stack([loss.double() for loss in losses.values()]).sum().backward()
    assert features.grad is not None
    assert bool(features.grad.isfinite().all())
    assert float(features.grad.abs().sum()) > 0


def test_a_step_overfits_one_pair() -> None:
    torch.manual_seed(0)
    extractor, pair, drawn = FeatureExtractor().train(), wall_pair(), generator()
    optimiser = torch.optim.Adam(extractor.parameters(), lr=1e-3)
    losses = []
    for _ in range(15):
        optimiser.zero_grad()
        losses.append(train_step(extractor, pair, ALL_LOSSES, drawn, strength=0.0)["contrastive"])
        optimiser.step()
    assert losses[-1] < losses[0] - 1
