"""Light that changes unevenly: it is taken out, and what a wrong pose does to an image is not."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from idfslam.alignment.displacement import compiled_displacement, displacement, plain_displacement
from idfslam.alignment.image_pyramid import pyramid
from idfslam.alignment.landmarks import Landmarks, landmarks
from idfslam.alignment.photometric import compiled_photometric_term, photometric_term, plain_photometric_term
from idfslam.alignment.sighting import Appearance, Sighting
from idfslam.alignment.uneven_light import plain_relit
from test_displacement import CAMERA, EYE, turned, wall

ACROSS = torch.linspace(0.4, 1.0, CAMERA.width).expand(CAMERA.height, CAMERA.width)  # a lamp on the right went out
SHADOW = torch.where(torch.arange(CAMERA.width) < 130, 0.5, 1.0).expand(CAMERA.height, CAMERA.width)


def lit(T_wc: Tensor, light: Tensor) -> Appearance:
    """The painted wall in this light (H, W)."""
    even = wall(T_wc)
    colour = (even.levels[0].luminance * light)[..., None].expand(*light.shape, 3).contiguous()
    return Appearance(pyramid(colour, CAMERA, height=240, levels=4), even.depth, CAMERA)


@pytest.fixture(scope="module")
def marks() -> Landmarks:
    of_wall = wall(EYE)
    return landmarks(of_wall.levels, of_wall.depth, count=1500, least=0.005)


@pytest.mark.parametrize("level", [0, 2])
@pytest.mark.parametrize("light", [ACROSS, SHADOW])
def test_the_compiled_form_is_the_plain_one(marks: Landmarks, light: Tensor, level: int) -> None:
    sighting = Sighting(lit(EYE, light), marks, EYE, turned(0.5), level)
    compiled, plain = (form(sighting, floor=1e-4, widest=3.0) for form in (compiled_photometric_term, plain_photometric_term))
    assert compiled.noise == pytest.approx(plain.noise, rel=2e-3)
    torch.testing.assert_close(compiled.b, plain.b, rtol=0, atol=5e-3 * float(plain.b.abs().max()))
    displaced = [form(sighting) for form in (compiled_displacement, plain_displacement)]
    assert displaced[0][0] == displaced[1][0] and displaced[0][1] == pytest.approx(displaced[1][1], rel=1e-3)


@pytest.mark.parametrize(("light", "even", "uneven"), [(ACROSS, 0.111, 0.0063), (SHADOW, 0.172, 0.0141)])
def test_light_is_taken_out(marks: Landmarks, light: Tensor, even: float, uneven: float) -> None:
    """Brightness differs by this much at the right pose, with one gain for the image and with one for each part."""
    sighting = Sighting(lit(EYE, light), marks, EYE, EYE, 0)
    assert photometric_term(sighting, floor=1e-6, widest=3.0, even=True).noise == pytest.approx(even, rel=0.2)
    assert photometric_term(sighting, floor=1e-6, widest=3.0).noise == pytest.approx(uneven, rel=0.2)


@pytest.mark.parametrize("light", [ACROSS, SHADOW])
def test_a_wrong_pose_shows_as_in_even_light(marks: Landmarks, light: Tensor) -> None:
    right, wrong = (math.degrees(displacement(lit(EYE, light), marks, EYE, turned(degrees))[1]) for degrees in (0.0, 1.0))
    of_wall = math.degrees(displacement(wall(EYE), marks, EYE, turned(1.0))[1])
    assert right < 0.15
    assert wrong == pytest.approx(of_wall, rel=0.2)


def test_the_displacement_of_an_edge_is_no_light() -> None:
    """Landmarks on one edge, all brighter by the same: light and displacement explain that alike, and it counts as displacement."""
    target, slope = torch.full((40,), 0.5), torch.full((40,), 0.1)
    place = torch.stack([torch.full((40,), 0.3), torch.linspace(0.2, 0.3, 40)], -1)
    others = torch.rand(400, 2, generator=torch.Generator().manual_seed(0)) * torch.tensor([0.4, 1.0]) + torch.tensor([0.6, 0.0])
    paint = torch.from_numpy(np.random.default_rng(0).uniform(0.2, 0.8, 400)).float()
    slopes = torch.from_numpy(np.random.default_rng(1).normal(0, 0.05, (2, 400))).float()
    relit = plain_relit(
        torch.cat([target, paint]),
        torch.cat([target + 0.05, paint]),
        torch.cat([slope, slopes[0]]),
        torch.cat([torch.zeros(40), slopes[1]]),
        torch.cat([place, others]),
    )
    assert float(relit.difference[:40].mean()) > 0.04
    assert float(relit.difference[40:].abs().median()) < 0.01


def test_no_landmarks_need_no_light() -> None:
    nothing = torch.zeros(0)
    assert len(plain_relit(nothing, nothing, nothing, nothing, torch.zeros(0, 3)).difference) == 0
