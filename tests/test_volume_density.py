"""iMAP's network, its surface, and the pixels that its map draws."""

import math
from dataclasses import replace

import pytest
import torch

from helpers.flat_wall import keyframe
from idfslam.config import IMAP, VolumeDensityConfig
from idfslam.mapping.active_sampling import cell_of
from idfslam.mapping.joint.density_map import DensityMap
from idfslam.mapping.joint.fourier_features import FourierFeatures
from idfslam.mapping.joint.volume_density import VolumeDensity


def test_fourier_features() -> None:
    features = FourierFeatures(2, 25.0, unit=10.0)
    with torch.no_grad():
        features.B.copy_(torch.tensor([[1.0, 0, 0], [0, 2, 1]]))
    # positions in tens of metres: sin(0.5), sin(2 * 0.2 + 0.1)
    torch.testing.assert_close(features(torch.tensor([[5.0, 2.0, 1.0]])), torch.sin(torch.tensor([[0.5, 0.5]])))
    assert [p.requires_grad for p in features.parameters()] == [True]  # the matrix is learnt


def test_the_matrix_has_the_papers_deviation() -> None:
    torch.manual_seed(0)
    assert float(FourierFeatures(4000, 25.0).B.detach().std()) == pytest.approx(25, rel=0.05)


def test_the_network_of_the_paper() -> None:
    field = VolumeDensity(VolumeDensityConfig())
    assert [(layer.in_features, layer.out_features) for layer in field.trunk] == [(93, 256), (256, 256), (256 + 93, 256), (256, 256)]
    assert (field.head.in_features, field.head.out_features) == (256, 4)
    density, colour = field.density(torch.zeros(5, 3))
    assert density.shape == (5,) and bool((density > 0).all())
    assert colour.shape == (5, 3) and bool(((colour > 0) & (colour < 1)).all())


def test_the_surface_is_where_a_truncation_is_half_opaque() -> None:
    field = VolumeDensity(VolumeDensityConfig(truncation=0.1))
    density = torch.tensor([0.0, math.log(2) / 0.1, 1e3])
    torch.testing.assert_close(field._level(density), torch.tensor([1.0, 0.0, -1.0]), atol=1e-6, rtol=0)


def density_map() -> DensityMap:
    torch.manual_seed(0)
    config = replace(IMAP, device="cpu", volume_density=replace(IMAP.volume_density, layers=2, width=16))
    return DensityMap(config, torch.device("cpu"), torch.Generator().manual_seed(0))


def test_active_pixels_follow_the_losses_of_frames_and_cells() -> None:
    # Two frames with mean losses 3 and 1: 300 and 100 of 400 pixels. In the first, one cell has 9 times the loss of the other 63.
    map, frames = density_map(), [keyframe(0, 0.0), keyframe(1, 0.1)]
    v, u = torch.meshgrid(torch.arange(3, 48, 6), torch.arange(4, 64, 8), indexing="ij")
    pixels = torch.stack([u, v], -1).reshape(-1, 2)  # one in the middle of each of 8 x 8 cells
    cells = cell_of(pixels, 48, 64, 8)
    losses = torch.where(cells == 10, 9.0, 1.0)
    drawn = map._active_pixels(frames, [pixels, pixels], [3 * losses / losses.mean(), torch.ones(64)], 400)
    assert [len(uv) for uv in drawn] == [300, 100]
    counts = torch.bincount(cell_of(drawn[0], 48, 64, 8), minlength=64)
    assert int(counts[10]) == pytest.approx(300 * 9 / 72, abs=1)  # 37.5
    assert int(counts[0]) == pytest.approx(300 / 72, abs=1)
    assert [round(map.loss_of(frame), 5) for frame in frames] == [3, 1]
    assert map.loss_of(keyframe(5, 0.0)) == 0


def test_uniform_pixels_keep_to_the_border() -> None:
    uv = density_map().uniform_pixels(keyframe(0, 0.0), 2000, 10)
    assert uv.min(0).values.tolist() == [10, 10]
    assert uv.max(0).values.tolist() == [53, 37]
