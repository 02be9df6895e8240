"""The turn of the camera by small images: of a painted wall and a synthetic room, in blur, without depth and without texture."""

import math

import pytest
import torch
from torch import Tensor

from idfslam.alignment import image_rotation
from idfslam.alignment.image_rotation import ImageRotation, compiled_turned_on_level, plain_turned_on_level
from idfslam.alignment.sighting import Appearance, Sighting
from idfslam.alignment.small_image import pixels_of, small_image
from test_displacement import CAMERA, EYE, appearance, turned, wall


def after(first: Appearance) -> ImageRotation:
    """A rotation whose last frame is this one."""
    rotation = ImageRotation()
    rotation.correct(first, EYE, EYE)
    rotation.accept(0, lost=False)
    return rotation


def degrees_off(T: Tensor, T_true: Tensor) -> float:
    R = T[:3, :3].T @ T_true[:3, :3]
    return math.degrees(math.acos(min((float(R.trace()) - 1) / 2, 1.0)))


@pytest.mark.parametrize("turn", [-6.0, -2.0, 0.5, 3.0, 6.0])
@pytest.mark.parametrize("blur", [0.0, 4.0])
def test_a_turn_that_the_prediction_missed_is_found_to_a_tenth_of_a_degree(turn: float, blur: float) -> None:
    T = after(wall(EYE)).correct(wall(turned(turn), blur=blur), EYE, EYE)
    assert degrees_off(T, turned(turn)) < 0.1


def test_a_pose_is_turned_as_a_keyframe_shows_wherever_the_last_frame_was() -> None:
    seen, small = pixels_of(small_image(wall(EYE))), small_image(wall(turned(3.0)))
    for wrong in (0.0, 5.0):
        T = image_rotation.turned(small, seen, turned(wrong), EYE)
        assert degrees_off(T, turned(3.0)) < 0.1


def test_the_predicted_shift_is_kept_and_a_change_of_exposure_does_not_matter() -> None:
    T_true = turned(2.0)
    T_true[:3, 3] = torch.tensor([0.03, 0.0, 0.02])
    predicted = EYE.clone()
    predicted[:3, 3] = T_true[:3, 3]
    T = after(wall(EYE)).correct(wall(T_true, gain=0.7, offset=0.05), predicted, EYE)
    assert torch.equal(T[:3, 3], predicted[:3, 3])
    assert degrees_off(T, T_true) < 0.1


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("level", [0, 1])
def test_the_compiled_steps_are_the_plain_ones(level: int, *, even: bool) -> None:
    sighting = Sighting(small_image(wall(turned(1.5))), pixels_of(small_image(wall(EYE))), EYE, EYE, level)
    found, plain = (form(sighting, even=even) for form in (compiled_turned_on_level, plain_turned_on_level))
    torch.testing.assert_close(found, plain, rtol=0, atol=2e-5)
    assert degrees_off(found, EYE) > 1
    assert torch.equal(sighting.T_wc, EYE)


def test_a_frame_without_depth_is_turned_too() -> None:
    first, second = wall(EYE), wall(turned(3.0))
    none = torch.zeros_like(first.depth)
    blind = [Appearance(frame.levels, none, frame.camera) for frame in (first, second)]
    assert degrees_off(after(blind[0]).correct(blind[1], EYE, EYE), turned(3.0)) < 0.1


def test_the_prediction_is_kept_without_texture_and_without_a_last_frame() -> None:
    grey = appearance(torch.full((240, 320, 3), 0.5), torch.full((240, 320), 2.0))
    assert torch.equal(after(grey).correct(grey, turned(2.0), EYE), turned(2.0))
    rotation = after(wall(EYE))
    rotation.accept(1, lost=True)
    assert torch.equal(rotation.correct(wall(turned(4.0)), EYE, EYE), EYE)


def test_the_last_frame_is_part_of_the_state() -> None:
    before, restored = after(wall(EYE)), ImageRotation()
    restored.restore(before.state())
    now = wall(turned(1.5))
    assert torch.equal(restored.correct(now, EYE, EYE), before.correct(now, EYE, EYE))
    restored.restore(ImageRotation().state())
    assert torch.equal(restored.correct(now, EYE, EYE), EYE)


def test_the_small_image_has_sixty_and_thirty_rows() -> None:
    small = small_image(wall(EYE))
    assert [tuple(level.luminance.shape) for level in small.levels] == [(60, 80), (30, 40)]
    assert len(pixels_of(small).points) == 30 * 40
    assert [len(seen) for seen in pixels_of(small).luminance] == [1200, 1200]


def test_a_frame_without_an_image_of_its_own_leaves_the_one_before() -> None:
    """The next view is turned from the last image that was new."""
    rotation = after(wall(EYE))
    rotation.accept(1, lost=False)
    assert rotation.index == 0
    assert degrees_off(rotation.correct(wall(turned(3.0)), EYE, EYE), turned(3.0)) < 0.1


def in_bands(T_wc: Tensor, phase: float) -> Appearance:
    """The painted wall under a lamp that flickers: two bands of 0.7 to 1.3 of the light over the rows of a rolling shutter."""
    rows = torch.arange(CAMERA.height)[:, None, None] / CAMERA.height
    light = 1 + 0.3 * torch.sin(2 * math.pi * (2 * rows + phase))
    steady = wall(T_wc)
    return appearance(steady.levels[0].luminance[..., None].expand(240, 320, 3) * light, steady.depth)


@pytest.mark.parametrize("wrong", [0.5, 1.0, 2.0, -2.0])
def test_bands_of_light_are_no_turn(wrong: float) -> None:
    """They wander by a third of their distance, as at 30 frames a second. Taken for even, they turn the pose by a degree."""
    small, seen = small_image(in_bands(turned(0.5), 1 / 3)), pixels_of(small_image(in_bands(EYE, 0)))
    assert degrees_off(image_rotation.turned(small, seen, turned(0.5 + wrong), EYE), turned(0.5)) < 0.02
    evenly = compiled_turned_on_level(Sighting(small, seen, EYE, turned(0.5 + wrong), 1), even=True)
    assert degrees_off(evenly, turned(0.5)) > 1
