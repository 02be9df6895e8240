"""A sparse volume: look-up, blending with another distance, and its tensors in a file."""

import numpy as np
import pytest
import torch

from helpers.plane_volume import plane_volume
from idfslam.fusion.constants import BLOCK
from idfslam.fusion.tsdf_volume import (
    TsdfVolume,
    compiled_blend,
    compiled_blend_lattices,
    no_volume,
    plain_blend,
    plain_blend_lattices,
)
from idfslam.fusion.volume_codec import tensors_of, volume_of


def random_volume() -> TsdfVolume:
    rng = np.random.default_rng(0)
    blocks = np.unique(rng.integers(-4, 4, (400, 3)), axis=0)
    shape = (len(blocks), BLOCK, BLOCK, BLOCK)
    distance, trust = rng.integers(-1023, 1024, shape).astype(np.int16), rng.integers(0, 256, shape).astype(np.uint8)
    return TsdfVolume(0.02, 0.05, blocks, distance, trust)


def test_blending_is_that_of_the_plain_form() -> None:
    volume, rng = random_volume(), np.random.default_rng(1)
    points, otherwise = rng.uniform(-0.7, 0.7, (5000, 3)).astype(np.float32), rng.normal(0, 0.1, 5000).astype(np.float32)
    found = compiled_blend(volume, points, otherwise)
    np.testing.assert_allclose(found, plain_blend(volume, points, otherwise), atol=1e-6)
    assert 0.1 < (found != otherwise).mean() < 0.9


@pytest.mark.parametrize("cells", [0.02, 0.013])  # the volume's voxels, and others
def test_lattices_are_blended_as_points_are(cells: float) -> None:
    volume, rng = random_volume(), np.random.default_rng(1)
    origins, otherwise = rng.integers(-30, 30, (40, 3)), rng.normal(0, 0.1, (40, 5, 5, 5)).astype(np.float32)
    points = (origins[:, None] + np.stack(np.meshgrid(*[np.arange(5)] * 3, indexing="ij"), -1).reshape(-1, 3)) * cells
    expected = volume.blend(points.reshape(-1, 3).astype(np.float32), otherwise.reshape(-1)).reshape(otherwise.shape)
    for form in (compiled_blend_lattices, plain_blend_lattices):
        np.testing.assert_allclose(form(volume, origins, cells, otherwise), expected, atol=2e-5)
    assert 0.1 < (expected != otherwise).mean() < 0.9


@pytest.mark.parametrize("form", [compiled_blend, plain_blend])
def test_without_blocks_nothing_is_blended(form: type) -> None:
    otherwise = np.array([0.1, -0.2], np.float32)
    assert np.array_equal(form(no_volume(), np.zeros((2, 3), np.float32), otherwise), otherwise)


def test_the_share_of_the_fused_distance_is_its_trust() -> None:
    points = np.array([[0.0, 0.0, 0.99], [0.031, -0.017, 1.013]], np.float32)
    otherwise = np.array([0.05, 0.05], np.float32)
    for trust in (0, 51, 255):
        expected = 0.05 + trust / 255 * ((1.0 - points[:, 2]) - 0.05)
        np.testing.assert_allclose(plane_volume(1.0, range(-2, 2), trust).blend(points, otherwise), expected, atol=5e-5)


def test_there_is_no_step_at_the_border_of_the_volume() -> None:
    """Along a line out of the volume, from a plane to another distance: no step is larger than a voxel's share."""
    volume = plane_volume(1.0, range(-1, 1))
    points = np.zeros((4000, 3), np.float32)
    points[:, 0], points[:, 2] = np.linspace(0, 0.2, 4000), 0.99
    blended = volume.blend(points, np.full(4000, -0.03, np.float32))
    assert blended[0] == pytest.approx(0.01, abs=1e-4) and blended[-1] == pytest.approx(-0.03)
    assert np.abs(np.diff(blended)).max() < 0.04 * (0.2 / 4000) / 0.01 * 1.1


def test_a_volume_comes_back_from_its_tensors() -> None:
    for volume in (random_volume(), no_volume()):
        back = volume_of(tensors_of(volume), volume.voxel, volume.truncation)
        assert (back.voxel, back.truncation) == (volume.voxel, volume.truncation)
        for name in ("blocks", "distance", "trust"):
            assert np.array_equal(getattr(back, name), getattr(volume, name))


def test_smooth_volumes_are_small() -> None:
    volume = plane_volume(1.0, range(-10, 10))
    size = sum(tensor.numel() * tensor.element_size() for tensor in tensors_of(volume).values())
    assert size < 0.02 * volume.distance.size * 3


def test_damaged_tensors_are_refused() -> None:
    volume = random_volume()
    whole = tensors_of(volume)
    damaged = {
        "expected": whole | {"blocks": whole["blocks"][:, :2]},
        "damaged": whole | {"low": torch.zeros(9, dtype=torch.uint8)},
        "other than": whole | {"trust": whole["trust"][:-200]},
        "steps": whole | {"high": whole["low"]},
    }
    for message, tensors in damaged.items():
        with pytest.raises(ValueError, match=message):
            volume_of(tensors, 0.02, 0.05)
    with pytest.raises(ValueError, match="voxels of"):
        volume_of(whole, float("nan"), 0.05)
