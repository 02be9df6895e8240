"""Light that flickers: bands of rows are taken out of both images, and what a wrong pose does to an image is not."""

import math

import pytest
import torch
from torch import Tensor

from idfslam.alignment.displacement import compiled_displacement, displacement, plain_displacement
from idfslam.alignment.flicker import plain_flicker
from idfslam.alignment.image_pyramid import pyramid
from idfslam.alignment.landmarks import Landmarks, landmarks
from idfslam.alignment.photometric import compiled_photometric_term, photometric_term, plain_photometric_term
from idfslam.alignment.sighting import Appearance, Sighting
from test_displacement import CAMERA, EYE, turned, wall


def flickering(T_wc: Tensor, amplitude: float, phase: float = 0.0) -> Appearance:
    """The painted wall under a lamp at 50 Hz, by a shutter of 26 ms: 2.6 bands of light."""
    even = wall(T_wc)
    rows = torch.arange(CAMERA.height)[:, None] / CAMERA.height
    light = 1 + amplitude * torch.sin(2 * math.pi * 2.6 * rows + phase)
    colour = (even.levels[0].luminance * light)[..., None].repeat(1, 1, 3).contiguous()
    return Appearance(pyramid(colour, CAMERA, height=240, levels=4), even.depth, CAMERA)


def marks_of(appearance: Appearance) -> Landmarks:
    return landmarks(appearance.levels, appearance.depth, count=1500, least=0.005)


@pytest.fixture(scope="module")
def steady() -> Landmarks:
    return marks_of(wall(EYE))


@pytest.mark.parametrize("level", [0, 2])
@pytest.mark.parametrize("amplitude", [0.05, 0.3, 0.5])
def test_the_compiled_form_is_the_plain_one(amplitude: float, level: int) -> None:
    marks = marks_of(flickering(EYE, amplitude))
    sighting = Sighting(flickering(turned(1.0), amplitude, 2.1), marks, EYE, turned(1.3), level)
    compiled, plain = (form(sighting, floor=1e-4, widest=3.0) for form in (compiled_photometric_term, plain_photometric_term))
    assert compiled.noise == pytest.approx(plain.noise, rel=2e-3)
    torch.testing.assert_close(compiled.b, plain.b, rtol=0, atol=5e-3 * float(plain.b.abs().max()))
    displaced = [form(sighting) for form in (compiled_displacement, plain_displacement)]
    assert displaced[0][0] == displaced[1][0] and displaced[0][1] == pytest.approx(displaced[1][1], rel=1e-3)


@pytest.mark.parametrize(("amplitude", "even", "found"), [(0.1, 0.047, 0.0034), (0.3, 0.140, 0.0114), (0.5, 0.236, 0.0213)])
def test_bands_are_taken_out(steady: Landmarks, amplitude: float, even: float, found: float) -> None:
    """Brightness differs by this much at the right pose, with one gain for the image and with one for each band."""
    sighting = Sighting(flickering(EYE, amplitude), steady, EYE, EYE, 0)
    assert photometric_term(sighting, floor=1e-6, widest=3.0, even=True).noise == pytest.approx(even, rel=0.1)
    assert photometric_term(sighting, floor=1e-6, widest=3.0).noise == pytest.approx(found, rel=0.2)


@pytest.mark.parametrize("amplitude", [0.1, 0.3, 0.5])
def test_a_wrong_pose_shows_as_in_steady_light(amplitude: float) -> None:
    """Both images have bands, at other rows of the wall."""
    marks = marks_of(flickering(EYE, amplitude))
    frame = flickering(turned(2.0), amplitude, 2.1)
    right, wrong = (math.degrees(displacement(frame, marks, EYE, turned(degrees))[1]) for degrees in (2.0, 3.0))
    of_wall = math.degrees(displacement(wall(turned(2.0)), marks_of(wall(EYE)), EYE, turned(3.0))[1])
    assert right < 0.13
    assert wrong == pytest.approx(of_wall, rel=0.1)


@pytest.mark.parametrize("off", [0.0, 0.5, 1.0, 2.0])
def test_steady_light_stays_as_it_is(steady: Landmarks, off: float) -> None:
    """At a wrong pose, too."""
    sighting = Sighting(wall(EYE), steady, EYE, turned(off), 2)
    places = sighting.places()
    seen = places.within & places.in_sight
    value, *slopes = sighting.image.at(places.uv)
    light = plain_flicker(*(x[seen] for x in (steady.luminance[2], value, *slopes, sighting.shares(places.uv)[:, 1:])))
    assert len(light) > 500 and bool((light == 1).all())


def test_a_black_image_is_no_flicker(steady: Landmarks) -> None:
    """All of its bands are darker by the same, which is exposure."""
    black = Appearance(pyramid(torch.zeros(240, 320, 3), CAMERA, height=240, levels=4), wall(EYE).depth, CAMERA)
    _, off = displacement(black, steady, EYE, EYE)
    assert math.degrees(off) > 1
