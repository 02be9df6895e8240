"""Pyramids of an image's brightness: means, cameras of the levels, and slopes."""

import pytest
import torch

from idfslam.alignment.image_pyramid import half, pyramid
from test_photometric import CAMERA


def test_pyramid_cameras_and_means() -> None:
    # A camera of 96 x 72 with at least 36 rows: 2 x 2 pixels become one. The centre of pixel (0, 0) is at -0.5 + 0.5 * 2 = 0.5 of the
    # old ones, so that cx' = (cx + 0.5) / 2 - 0.5.
    colour = torch.rand(72, 96, 3, generator=torch.Generator().manual_seed(0))
    levels = pyramid(colour, CAMERA, height=36, levels=2)
    assert [tuple(level.luminance.shape) for level in levels] == [(36, 48), (18, 24)]
    fine = levels[0].camera
    assert (fine.width, fine.height, fine.fx, fine.fy) == (48, 36, 40.0, 40.0)
    assert (fine.cx, fine.cy) == pytest.approx((23.5, 17.5))
    torch.testing.assert_close(levels[0].luminance[3, 5], colour[6:8, 10:12].mean())
    torch.testing.assert_close(levels[1].luminance[2, 4], colour[8:12, 16:20].mean())


def test_halves_of_opencv_are_those_of_torch() -> None:
    image = torch.rand(72, 96, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(half(image), torch.nn.functional.avg_pool2d(image[None], 2)[0])


def test_a_small_image_is_not_enlarged() -> None:
    assert pyramid(torch.zeros(72, 96, 3), CAMERA, height=480, levels=1)[0].luminance.shape == (72, 96)


def test_slopes_on_a_ramp() -> None:
    # Luminance 0.01 u + 0.02 v: the same slopes everywhere but at the border.
    v, u = torch.meshgrid(torch.arange(72.0), torch.arange(96.0), indexing="ij")
    ramp = (0.01 * u + 0.02 * v)[..., None].expand(72, 96, 3) / 4
    level = pyramid(ramp, CAMERA, height=72, levels=1)[0]
    value, slope_u, slope_v = level.at(torch.tensor([[10.25, 20.5], [60.0, 30.0]]))
    torch.testing.assert_close(value, torch.tensor([0.1025 + 0.41, 0.6 + 0.6]) / 4)
    torch.testing.assert_close(torch.stack([slope_u, slope_v]), torch.tensor([[0.01, 0.01], [0.02, 0.02]]) / 4)
