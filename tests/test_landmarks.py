"""The choice of landmarks: the steepest pixel of each cell, with depth and off its edges; compiled and plain."""

import pytest
import torch

from idfslam.alignment.image_pyramid import compiled_sampled, plain_sampled, pyramid
from idfslam.alignment.landmarks import compiled_steepest, landmarks, plain_steepest
from test_photometric import CAMERA, EYE, view


def test_landmarks_avoid_edges_of_depth_and_holes() -> None:
    colour = torch.rand(72, 96, 3, generator=torch.Generator().manual_seed(0))
    depth = torch.full((72, 96), 1.0)
    depth[:, 48:] = 2.0  # an edge between columns 47 and 48
    depth[20:40, 10:30] = 0.0
    marks = landmarks(pyramid(colour, CAMERA, height=72, levels=2), depth, count=1500)
    uv, z = CAMERA.project(marks.points)
    u, v = uv.round().long().unbind(-1)
    assert len(u) > 800
    torch.testing.assert_close(z, depth[v, u])
    assert not ((u == 47) | (u == 48)).any()
    assert not ((u >= 9) & (u <= 30) & (v >= 19) & (v <= 40)).any()  # neither in the hole nor at its rim
    assert [len(level) for level in marks.luminance] == [len(u)] * 2
    torch.testing.assert_close(marks.luminance[0], colour.mean(-1)[v, u], atol=1e-4, rtol=0)


@pytest.mark.parametrize(("height", "cell"), [(72, 3), (36, 5)])
def test_the_same_pixels_are_steepest(height: int, cell: int) -> None:
    colour, depth = view(EYE, noise=0.02)
    depth[20:40, 30:60] += 1.0  # edges, and holes beside
    depth[torch.rand(72, 96, generator=torch.Generator().manual_seed(1)) < 0.02] = 0
    fine = pyramid(colour, CAMERA, height=height, levels=1)[0]
    for found, plain in zip(compiled_steepest(fine, depth, cell, 0.025), plain_steepest(fine, depth, cell, 0.025)):
        assert len(plain) > 50 and torch.equal(found, plain)


def test_a_plain_image_has_no_landmarks() -> None:
    assert len(landmarks(pyramid(torch.full((72, 96, 3), 0.5), CAMERA, height=72, levels=1), torch.ones(72, 96), count=100).points) == 0


def test_the_compiled_samples_are_the_plain_ones_beyond_the_border_too() -> None:
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(30, 40, generator=generator)
    uv = torch.rand(500, 2, generator=generator) * torch.tensor([46.0, 36.0]) - 3
    torch.testing.assert_close(compiled_sampled(image, uv), plain_sampled(image, uv), rtol=0, atol=2e-5)


def test_in_the_dark_weaker_landmarks_are_taken_as_far_as_they_stand_out_from_noise() -> None:
    colour, depth = view(EYE)
    grain = torch.randn(colour.shape, generator=torch.Generator().manual_seed(0))
    light, dark, noisy = (
        landmarks(pyramid(gain * colour + noise * grain, CAMERA, height=72, levels=1), depth, count=400)
        for gain, noise in ((1.0, 0.0), (0.3, 0.0), (0.3, 0.015))
    )
    assert len(light.points) > 200 and len(dark.points) > 300 and len(noisy.points) < 50
