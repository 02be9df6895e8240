"""Patches that are aligned to a fraction of a pixel, and poses by image and depth together, on textured walls with known poses."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from idfslam.config import FinetuneConfig, TrackerConfig
from idfslam.frame import Frame, Status
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.tracking.frame_features import FrameFeatures
from idfslam.tracking.patch_alignment import (
    AlignedPatches,
    aligned_patches,
    compiled_align_patches,
    compiled_projection_system,
    plain_align_patches,
    plain_projection_system,
)
from idfslam.tracking.refined_registration import RefinedRegistration
from idfslam.tracking.tracker import Tracker

CAMERA = Camera(320, 240, 280.0, 280.0, 159.5, 119.5)
NO_FINETUNING = FinetuneConfig(enabled=False)
T_KC = se3.exp(torch.tensor([0.08, -0.05, 0.06, 0.06, -0.09, 0.12], dtype=torch.float64))  # 11 cm, 9 degrees
START = torch.eye(4, dtype=torch.float64)


def texture(x: Tensor, y: Tensor) -> Tensor:
    """Smooth random brightness in [0, 1] of a wall's points [m]: waves of 5 cm and more in all directions."""
    rng = np.random.default_rng(0)
    waves = [(rng.uniform(5, 120), rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi)) for _ in range(60)]
    total = sum(torch.sin(k * (np.cos(a) * x + np.sin(a) * y) + phase) for k, a, phase in waves)
    return torch.sigmoid(torch.as_tensor(total) / 4)


def frame(T_wc: Tensor, gain: float = 1.0, T_depth: Tensor | None = None, index: int = 0) -> Frame:
    """The corner of a wall z = 2 m and a wall x = 0.9 m, both textured; depth as seen from `T_depth` if that is given."""

    def seen(T: Tensor) -> tuple[Tensor, Tensor]:
        rays = CAMERA.rays(CAMERA.pixels()).double() @ T[:3, :3].T
        front, side = (2 - T[2, 3]) / rays[..., 2], (0.9 - T[0, 3]) / rays[..., 0]
        on_side = (side > 0) & (side < front)
        depth = torch.where(on_side, side, front)
        points = T[:3, 3] + rays * depth[..., None]
        return depth, texture(torch.where(on_side, points[..., 2] + 5, points[..., 0]), points[..., 1])

    depth = seen(T_wc if T_depth is None else T_depth)[0]
    colour = (gain * seen(T_wc)[1])[..., None].expand(-1, -1, 3)
    return Frame(index, float(index), colour.float().numpy().copy(), depth.float().numpy(), CAMERA)


@pytest.fixture(scope="module")
def tracker() -> Tracker:
    return Tracker(TrackerConfig(), NO_FINETUNING)


@pytest.fixture(scope="module")
def keyframe(tracker: Tracker) -> FrameFeatures:
    return tracker.extract_features(frame(START))


def error(T: Tensor, truth: Tensor = T_KC) -> tuple[float, float]:
    """[cm], [degrees]."""
    delta = (se3.inverse(truth) @ T).detach()
    return 100 * float(delta[:3, 3].norm()), math.degrees(float(se3.angle(delta)))


def test_patches_lie_on_the_walls(keyframe: FrameFeatures) -> None:
    patches = keyframe.patches
    assert len(patches) > 100
    on_a_wall = torch.minimum((patches.points[:, 2] - 2).abs(), (patches.points[:, 0] - 0.9).abs())
    assert float(on_a_wall.max()) < 0.005
    torch.testing.assert_close(CAMERA.project(patches.points)[0], patches.uv)


def test_a_shift_is_found_to_a_twentieth_of_a_pixel_whatever_the_exposure() -> None:
    def image(dx: float, dy: float, gain: float) -> Tensor:
        v, u = torch.meshgrid(torch.arange(60.0), torch.arange(80.0), indexing="ij")
        return (gain * 200 * texture((u + dx).double() / 150, (v + dy).double() / 150) + 20).round().to(torch.uint8)

    uv = torch.tensor([[30.0, 30.0], [40.0, 25.0], [45.0, 35.0]])
    warp = torch.eye(2).expand(3, 2, 2)
    found, _, correlation = compiled_align_patches(image(0, 0, 1), image(1.3, -0.6, 0.5), uv, warp, uv)
    assert float(correlation.min()) > 0.99
    torch.testing.assert_close(found, uv - torch.tensor([1.3, -0.6]), atol=0.05, rtol=0)


def test_the_compiled_alignment_is_that_of_torch(tracker: Tracker, keyframe: FrameFeatures) -> None:
    other = tracker.extract_features(frame(se3.exp(torch.tensor([0.01, 0.0, 0.0, 0.0, 0.005, 0.0], dtype=torch.float64))))
    uv = keyframe.patches.uv.float() / 2
    generator = torch.Generator().manual_seed(0)
    warp = torch.eye(2) + 0.1 * torch.randn(len(uv), 2, 2, generator=generator)
    start = uv + torch.randn(len(uv), 2, generator=generator)
    for images in ((keyframe.pyramid[1], keyframe.pyramid[1]), (keyframe.pyramid[1], other.pyramid[1])):
        compiled, plain = (align(*images, uv, warp, start) for align in (compiled_align_patches, plain_align_patches))
        good = (compiled[2] > 0.8) & (plain[2] > 0.8)
        assert int(good.sum()) > 20
        assert int(((compiled[2] > 0.8) != (plain[2] > 0.8)).sum()) <= 2  # at the image's border and at the limit of a shift
        for a, b in zip(compiled, plain):
            torch.testing.assert_close(a[good], b[good], atol=2e-3, rtol=1e-3)


def test_the_compiled_projections_are_those_of_torch() -> None:
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(40, 3, generator=generator, dtype=torch.float64) + torch.tensor([-0.5, -0.5, 1.5])
    root = torch.rand(40, 2, 2, generator=generator, dtype=torch.float64)
    uv = CAMERA.project(se3.transform(se3.inverse(T_KC), points))[0] + torch.randn(40, 2, generator=generator, dtype=torch.float64)
    depth = points[:, 2] + 0.05 * torch.randn(40, generator=generator, dtype=torch.float64)
    patches = AlignedPatches(points, uv, root @ root.mT + torch.eye(2), depth, torch.linspace(0, 4e3, 40).double(), CAMERA)
    for a, b in zip(compiled_projection_system(patches, T_KC, 3.0), plain_projection_system(patches, T_KC, 3.0)):
        torch.testing.assert_close(a, b)


def test_the_gradient_of_the_projections_is_right() -> None:
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(40, 3, generator=generator, dtype=torch.float64) + torch.tensor([-0.5, -0.5, 1.5])
    uv = CAMERA.project(se3.transform(se3.inverse(T_KC), points))[0] + torch.randn(40, 2, generator=generator, dtype=torch.float64)
    depth, information = points[:, 2] + 0.05, torch.linspace(0, 4e3, 40).double()
    patches = AlignedPatches(points, uv, torch.eye(2, dtype=torch.float64).expand(40, 2, 2), depth, information, CAMERA)
    delta = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    projected, z = CAMERA.project(se3.transform(se3.inverse(se3.exp(delta) @ T_KC), points))
    (((projected - uv).square().sum() + (information * (z - depth).square()).sum()) / 2).backward()
    gradient = delta.grad
    assert gradient is not None
    torch.testing.assert_close(patches.system(T_KC, 1e9)[1], -gradient)


def test_the_image_alone_gives_the_pose(tracker: Tracker, keyframe: FrameFeatures) -> None:
    other = tracker.extract_features(frame(T_KC, gain=0.7))
    guess = se3.exp(torch.tensor([0.01, 0.0, -0.01, 0.005, 0.01, -0.005], dtype=torch.float64)) @ T_KC
    found = aligned_patches(guess, other, keyframe)
    assert found is not None
    T_kc, patches = found
    assert patches.inliers(T_kc) > 60
    centimetres, degrees = error(T_kc)
    assert centimetres < 0.1
    assert degrees < 0.03


def test_a_view_without_texture_or_of_few_pixels_has_no_patches(tracker: Tracker, keyframe: FrameFeatures) -> None:
    blank = tracker.extract_features(Frame.blank(0, 0.0, CAMERA))
    assert len(blank.patches) == 0
    assert aligned_patches(T_KC, keyframe, blank) is None
    small = replace(keyframe, grey=keyframe.grey[:40, :60].contiguous())
    assert len(small.patches) == 0


def test_image_and_depth_together(tracker: Tracker, keyframe: FrameFeatures) -> None:
    result = tracker.track(tracker.extract_features(frame(T_KC)), keyframe)
    assert result.status is Status.OK
    centimetres, degrees = error(torch.from_numpy(result.T_kc))
    assert centimetres < 0.1
    assert degrees < 0.03
    assert result.covariance is not None
    assert result.patches > 60
    assert 1e-5 < float(np.sqrt(result.covariance[:3, :3].trace())) < 0.005


def test_the_image_counts_more_where_depth_was_taken_at_another_time(tracker: Tracker, keyframe: FrameFeatures) -> None:
    # Depth is that of a camera 6 degrees and 13 cm farther on: ICP alone follows it by 4.6 degrees. The pose is the colour image's.
    later = T_KC @ se3.exp(torch.tensor([0.1, 0.05, 0.06, 0.04, 0.06, -0.08], dtype=torch.float64))
    late = tracker.extract_features(frame(T_KC, T_depth=later))
    result = tracker.track(late, keyframe)
    by_planes = Tracker(replace(TrackerConfig(), patches=False), NO_FINETUNING).track(late, keyframe)
    assert error(torch.from_numpy(by_planes.T_kc))[1] > 4.0
    assert result.status is Status.OK
    assert error(torch.from_numpy(result.T_kc))[1] < 2.1
    ideal = tracker.track(tracker.extract_features(frame(T_KC)), keyframe)
    assert result.covariance is not None
    assert ideal.covariance is not None
    assert float(result.covariance.trace()) > 1000 * float(ideal.covariance.trace())  # it says that it is less sure


def test_patches_belong_to_the_pose_that_is_asked(tracker: Tracker, keyframe: FrameFeatures) -> None:
    other = tracker.extract_features(frame(T_KC))
    pairs, pose = tracker.register(other, keyframe)
    assert isinstance(pose, RefinedRegistration)
    wrong = replace(pose, T_ab=se3.exp(torch.tensor([0.0, 0.0, -0.2, 0.0, 0.0, 0.0], dtype=torch.float64)) @ pose.T_ab)
    assert tracker.is_consistent(pose, pairs, other, keyframe)
    assert not tracker.is_consistent(wrong, pairs, other, keyframe)


def test_near_a_known_pose_no_features_are_needed(tracker: Tracker, keyframe: FrameFeatures) -> None:
    images = tracker.images(frame(T_KC, gain=0.6))
    assert images.trunk.numel() == 0
    guess = se3.exp(torch.tensor([0.01, 0.0, -0.01, 0.005, 0.01, -0.01], dtype=torch.float64)) @ T_KC  # 0.9 degrees off
    result = tracker.track_near(images, keyframe, guess.numpy())
    assert result.status is Status.OK
    assert (result.matches, result.inliers) == (0, 0)
    centimetres, degrees = error(torch.from_numpy(result.T_kc))
    assert centimetres < 0.1
    assert degrees < 0.03
    far = se3.exp(torch.tensor([0.0, 0.0, 0.0, 0.0, 0.3, 0.0], dtype=torch.float64)) @ T_KC
    assert tracker.track_near(images, keyframe, far.numpy()).status is Status.LOST
    assert torch.equal(tracker.extract_features(images).trunk, tracker.extract_features(frame(T_KC, gain=0.6)).trunk)
