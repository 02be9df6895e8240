"""The shading of a bare wall: shifts that it tells through noise and exposure, and what it cannot know."""

import pytest
import torch
from torch import Tensor

from helpers.three_walls import EYE, WALL, aligner, error, pose, taught, view
from idfslam.alignment.motion import moved
from idfslam.alignment.row_moments import PoseEquations
from idfslam.alignment.shading import Shading
from idfslam.alignment.sighting import Appearance
from idfslam.alignment.small_image import pixels_of, small_image
from test_displacement import CAMERA, appearance

ALONG = torch.tensor([0.03, -0.02, 0, 0, 0, 0], dtype=torch.float64)  # [m] along the wall: four and three pixels of 240 rows
NOISE = 0.01  # [1] of each colour of a pixel, as a Kinect has it


def shaded(T_wc: Tensor, seed: int, *, light: float = 0.06, ramp: float = 0.0, gain: float = 1.0, offset: float = 0.0) -> Appearance:
    """A bare wall 2 m ahead under a lamp. ramp: brightness that it gains a metre to the right. Noise of this seed."""
    rays = CAMERA.rays(CAMERA.pixels()).double() @ T_wc[:3, :3].T
    x, y, _ = (T_wc[:3, 3] + rays * ((2 - T_wc[2, 3]) / rays[..., 2:])).unbind(-1)
    brightness = gain * (0.6 + light * torch.exp(-((x - 0.3) ** 2 + (y + 0.4) ** 2)) + ramp * x) + offset
    noise = NOISE * torch.randn(*brightness.shape, 3, generator=torch.Generator().manual_seed(seed))
    return appearance(brightness[..., None] + noise, torch.full(brightness.shape, 2.0))


def compared(frame: Appearance, keyframe: Appearance) -> Shading:
    return Shading(small_image(frame), [(pixels_of(small_image(keyframe), with_depth=True), EYE)])


def term(frame: Appearance, keyframe: Appearance, T: Tensor = EYE) -> PoseEquations:
    return compared(frame, keyframe).term(T, moments=False)


def shift(found: PoseEquations) -> Tensor:
    """[m] (2,) the step along the wall."""
    return torch.linalg.solve(found.H[:2, :2], found.b[:2])


def sigma(found: PoseEquations) -> float:
    """[m] the larger standard deviation along the wall."""
    return float(torch.linalg.eigvalsh(found.H[:2, :2])[0].clamp(min=1e-12) ** -0.5)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (0.85, 0.05)])
def test_a_shift_of_centimetres_is_found_to_millimetres(seed: int, gain: float, offset: float) -> None:
    frame, keyframe = shaded(moved(EYE, ALONG), 10 + seed, gain=gain, offset=offset), shaded(EYE, seed)
    T = EYE
    for _ in range(3):
        found = term(frame, keyframe, T)
        T = moved(T, torch.cat([shift(found), torch.zeros(4, dtype=torch.float64)]))
    assert float((T[:2, 3] - ALONG[:2]).norm()) < 0.008
    assert 0.001 < sigma(found) < 0.008


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_noise_of_an_even_wall_measures_nothing(seed: int) -> None:
    found = term(shaded(EYE, 10 + seed, light=0.0), shaded(EYE, seed, light=0.0))
    assert float(found.H.abs().max()) < 1e-3
    assert float(found.b.abs().max()) < 1e-3


def test_along_an_even_slope_a_shift_cannot_be_told_from_an_exposure() -> None:
    found = term(shaded(moved(EYE, ALONG), 1, light=0.0, ramp=0.1), shaded(EYE, 0, light=0.0, ramp=0.1))
    assert float(found.H[0, 0]) < 0.01 / 0.008**2


def test_a_keyframe_that_is_hardly_in_view_tells_nothing() -> None:
    far = torch.tensor([2.0, 0, 0, 0, 0, 0], dtype=torch.float64)
    assert not term(shaded(EYE, 1), shaded(EYE, 0), moved(EYE, far)).H.any()


def test_with_moments_all_rows_count_as_the_middle_one() -> None:
    found = compared(shaded(EYE, 1), shaded(EYE, 0)).term(EYE, moments=True)
    assert found.sums.H.shape == (3, 6, 6)
    assert found.sums.H[0].any() and not found.sums.H[1:].any() and not found.sums.b[1:].any()


def test_an_alignment_follows_the_shading_where_depth_leaves_it_open() -> None:
    truth = pose(0.03, 0.02, 0.0, 0, 0, 0)
    wall, keyframe = taught(WALL), view(WALL, EYE, paint=0.02)  # too faint for landmarks
    judge = aligner(wall)
    assert not len(judge.appearances.landmarks(keyframe).points)
    alone, found = (judge.align(view(WALL, truth, paint=0.02), EYE, references) for references in ([], [keyframe]))
    assert error(alone.T_wc, truth)[0] > 0.025
    assert error(found.T_wc, truth)[0] < 0.005
    assert alone.information is not None and found.information is not None
    assert float(found.information.values[0]) > 10 * float(alone.information.values[0])


def test_a_small_step_is_carried_linearly() -> None:
    shading, step = compared(shaded(moved(EYE, ALONG), 1), shaded(EYE, 0)), torch.tensor([1e-3, -1e-3, 0, 0, 0, 0], dtype=torch.float64)
    at, near = shading.term(EYE, moments=False), shading.term(moved(EYE, step), moments=False)
    torch.testing.assert_close(near.b, at.b - at.H @ step)
    assert torch.equal(near.H, at.H)
    assert not torch.equal(shading.term(moved(EYE, 3 * step), moments=False).H, at.H)
