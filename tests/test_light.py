"""Exposure and vignetting: recovered from places that several images see, and left alone where there are none."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from helpers.differences import differences
from helpers.flat_wall import at
from idfslam.alignment.image_pyramid import pyramid
from idfslam.compute.backend import plain_torch
from idfslam.config import FAST, PAPER
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.mapping.mapper import _cast
from idfslam.mapping.rays import cast
from idfslam.mapping.training_view import TrainingView
from idfslam.sensing.light import Light
from idfslam.sensing.light_comparison import BRIGHTEST, DARKEST, Comparison, compare, prior
from idfslam.sensing.light_solution import differ, exposure_changes, exposure_over, exposures, vignette
from idfslam.sensing.matched_exposure import matched_exposure
from idfslam.sensing.vignette import Vignette, even_powers
from idfslam.slam import Slam
from idfslam.slam.back_end.light_estimation import LightEstimation, compiled_shared, opencv_means, plain_means, plain_shared, thumbnail
from idfslam.slam.compose import System

CAMERA = Camera(160, 120, 100.0, 100.0, 79.5, 59.5)  # 2 m before a wall: a shift of 1 m moves it by 50 px
VIGNETTE = Vignette((-0.2, -0.15))  # 70 % of the light at the corner
GAINS = (1.0, 1.1, 1.25, 0.9, 0.8, 0.95, 1.05, 1.15)


def wall(gain: float, x: float, index: int, lens: Vignette | None, offset: float = 0.0) -> Keyframe:
    """A view from x [m] along a wall with soft stripes in both directions, recorded with some grain."""
    uv = CAMERA.pixels()
    X, Y = (uv[..., 0] - CAMERA.cx) / 50 + x, (uv[..., 1] - CAMERA.cy) / 50
    scene = 0.4 + 0.1 * torch.sin(5 * X + torch.arange(3)[:, None, None]) + 0.1 * torch.cos(4 * Y + 2 * X)
    grain = 0.004 * torch.randn(120, 160, 3, generator=torch.Generator().manual_seed(index))
    share = 1.0 if lens is None else lens.image(CAMERA)[..., None]
    colour = (share * gain * (scene.permute(1, 2, 0) + offset) + grain).clamp(0, 1)
    depth = torch.full((120, 160), 2.0)
    return Keyframe(Frame(index, index / 30, colour.numpy(), depth.numpy(), CAMERA), at(x), depth, colour)


def walk(light: LightEstimation, gains: tuple[float, ...], lens: Vignette | None) -> None:
    """Keyframes every 0.35 m, to the right and back again."""
    for i, gain in enumerate(gains):
        keyframe = wall(gain, 0.35 * min(i, 8 - i), i, lens)
        assert light.graph.insert(keyframe)
        light.on_keyframe(keyframe)


def estimation() -> LightEstimation:
    return LightEstimation(KeyframeGraph(replace(FAST.keyframes, cull=1.0)))


def places(gains: tuple[float, float], offsets: tuple[float, float], lens: Vignette, seed: int, noise: float = 0.005) -> Comparison:
    """A comparison of 3000 places at random radii of two images."""
    rng = np.random.default_rng(seed)
    scene, powers = rng.uniform(0.15, 0.7, (3000, 3)), [r[:, None] ** (2, 4) for r in rng.uniform(0, 1, (2, 3000))]
    images = [
        np.exp(p @ lens.coefficients)[:, None] * gain * (scene + offset) + rng.normal(0, noise, (3000, 3))
        for p, gain, offset in zip(powers, gains, offsets)
    ]
    found = compare(*images, *powers, np.full(3000, 0.005))
    assert found is not None
    return found


def test_the_means_of_a_small_image_are_the_plain_ones() -> None:
    colour = torch.rand(122, 163, 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(opencv_means(colour, 4), plain_means(colour, 4), rtol=0, atol=1e-6)


def test_the_compiled_places_that_two_images_share_are_the_plain_ones() -> None:
    a, b = (wall(gain, x, i, None) for i, (gain, x) in enumerate([(1.0, 0.0), (1.1, 0.357)]))  # no place lies between two pixels
    of_a, of_b = (thumbnail(k.colour, k.depth, k.camera) for k in (a, b))
    of_b.depth[40:60, 30:50] = 1.5  # hides something
    compiled, plain = (shared(of_a.places, of_b, at(-0.357)) for shared in (compiled_shared, plain_shared))
    assert 5000 < len(plain[0]) == len(compiled[0]) < 6000
    for one, other in zip(compiled, plain):
        np.testing.assert_allclose(one, other, rtol=0, atol=2e-5)


def test_the_compiled_comparison_is_that_of_numpy() -> None:
    rng = np.random.default_rng(0)
    a, powers = rng.uniform(0.1, 0.9, (400, 3)), [rng.uniform(0, 1, (400, 2)) for _ in range(2)]
    b, noise = a * np.exp(rng.standard_t(2, (400, 3)) * 0.01), rng.uniform(0.005, 0.02, 400)
    usable = (np.minimum(a, b) > DARKEST) & (np.maximum(a, b) < BRIGHTEST)
    found = compare(a, b, *powers, noise)
    assert found is not None
    for channel in range(3):
        k = usable[:, channel]
        colour, difference = (a + b)[k, channel] / 2, np.log(a / b)[k, channel]
        J, sigma = np.column_stack([np.ones_like(colour), 1 / colour, (powers[0] - powers[1])[k]]), noise[k] / colour
        r = (difference - np.median(difference)) / sigma
        for _ in range(3):
            scale = max(1.4826 * np.median(np.abs(r)), 0.01 / np.median(sigma))
            weighted = J / ((1 + (r / (2 * scale)) ** 2) ** 2 * (scale * sigma) ** 2)[:, None]
            r = (difference - J @ np.linalg.solve(weighted.T @ J + np.diag(prior()), weighted.T @ difference)) / sigma
        share = min(1.0, 400 / k.sum())
        np.testing.assert_allclose(found.normal[channel], share * weighted.T @ J, rtol=1e-9, atol=1e-6)
        np.testing.assert_allclose(found.right[channel], share * weighted.T @ difference, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("lens", [Vignette(), VIGNETTE])
def test_gains_are_recovered_within_one_percent_and_offsets_within_a_grey_step(lens: Vignette) -> None:
    offsets = (0.0, 0.004, -0.006, 0.01, 0.0, -0.004, 0.002, 0.008)
    pairs = [(i, j) for i in range(8) for j in range(max(0, i - 3), i)]
    found = [places((GAINS[i], GAINS[j]), (offsets[i], offsets[j]), lens, 10 * i + j) for i, j in pairs]
    solved = exposures(pairs, found, 8, vignette(found))
    np.testing.assert_allclose(np.exp(solved[..., 0]), np.tile(np.array(GAINS)[:, None], (1, 3)), rtol=0.01)
    np.testing.assert_allclose(solved[..., 1], np.tile(np.array(offsets)[:, None], (1, 3)), atol=1 / 255)


def test_the_vignette_is_recovered_and_none_is_seen_where_there_is_none() -> None:
    gains = [(GAINS[i], GAINS[i - 1]) for i in range(1, 8)]
    found = vignette([places(gain, (0.0, 0.0), VIGNETTE, seed) for seed, gain in enumerate(gains * 2)])
    assert found is not None
    assert found.corner == pytest.approx(VIGNETTE.corner, rel=0.02)
    assert vignette([places(gain, (0.0, 0.0), Vignette(), seed) for seed, gain in enumerate(gains * 2)]) is None
    assert (
        vignette([places(gain, (0.0, 0.0), VIGNETTE, seed) for seed, gain in enumerate(gains)]) is None
    )  # too few pairs say how sure it is


def test_noise_does_not_draw_gains_to_one_side() -> None:
    """A regression of one image on the other would find 0.94 in both directions."""
    for pair in ((1, 0), (0, 1)):
        found = [places((1.0, 1.0), (0.0, 0.0), Vignette(), seed, noise=0.04) for seed in range(5)]
        gain = np.exp(exposures([pair] * 5, found, 2, None)[1, :, 0])
        np.testing.assert_allclose(gain, 1.0, atol=0.01)


def test_the_exposure_of_one_image_is_that_of_a_pair() -> None:
    found = [places((1.3, 0.9), (0.01, 0.0), VIGNETTE, seed) for seed in range(3)]
    np.testing.assert_allclose(exposure_over(found, VIGNETTE), exposures([(1, 0)] * 3, found, 2, VIGNETTE)[1], atol=1e-9)


def test_one_exposure_counts_as_no_change() -> None:
    same = [places((1.0, 1.0), (0.0, 0.0), Vignette(), seed) for seed in range(6)]
    assert not exposure_changes(same, None)
    assert exposure_changes([*same, places((1.02, 1.0), (0.0, 0.0), Vignette(), 7)], None)
    assert not exposure_changes([], None)


def test_black_and_white_say_nothing() -> None:
    dark = np.full((500, 3), 0.02)
    assert compare(dark, dark, np.zeros((500, 2)), np.zeros((500, 2)), np.full(500, 0.005)) is None


def test_light_takes_a_colour_to_the_scene_and_back() -> None:
    uv = torch.tensor([[0.0, 0.0], [79.5, 59.5]])
    light = Light(torch.tensor([1.25, 1.0, 0.8]), torch.tensor([0.02, 0.0, -0.02]), Vignette((-0.25,) * 2))
    scene = torch.full((2, 3), 0.5)
    recorded = light.recorded(scene, uv, CAMERA)
    torch.testing.assert_close(recorded[1], torch.tensor([0.65, 0.5, 0.384]))  # no vignetting in the middle
    corner = float(torch.tensor([-0.25 * (p + p * p) for p in [(79.5**2 + 59.5**2) / 100**2]]).exp())
    torch.testing.assert_close(recorded[0], recorded[1] * corner)
    torch.testing.assert_close(light.scene(recorded, uv, CAMERA), scene)


def test_radius_one_is_half_the_diagonal_from_the_principal_point() -> None:
    off_centre = Camera(160, 120, 100.0, 100.0, 70.0, 50.0)
    torch.testing.assert_close(
        even_powers(torch.tensor([[70.0 + 80, 50.0 + 60], [70.0, 50.0]]), off_centre), torch.tensor([[1.0, 1.0], [0, 0]])
    )
    assert float(VIGNETTE.share(torch.tensor([[150.0, 110.0]]), off_centre)) == pytest.approx(VIGNETTE.corner)


@pytest.mark.parametrize("lens", [None, VIGNETTE])
def test_keyframes_of_a_walk_get_their_exposures_and_the_vignette(lens: Vignette | None) -> None:
    light = estimation()
    walk(light, GAINS, lens)
    found = [light.of(keyframe) for keyframe in light.graph.keyframes]
    for gain, of_keyframe in zip(GAINS, found, strict=True):
        assert of_keyframe is not None
        torch.testing.assert_close(
            of_keyframe.gain + of_keyframe.gain * of_keyframe.offset / 0.4, torch.full((3,), gain), rtol=0.01, atol=0
        )
    assert (light.vignette is None) == (lens is None)
    if lens is not None and light.vignette is not None:
        assert light.vignette.corner == pytest.approx(lens.corner, rel=0.02)


def test_a_view_that_is_no_keyframe_gets_its_exposure_too() -> None:
    light = estimation()
    walk(light, GAINS, None)
    view = wall(1.3, 0.2, 8, None)
    light.graph.connect_like_last(view)
    found = light.of(view)
    assert found is not None
    torch.testing.assert_close(found.gain + found.gain * found.offset / 0.4, torch.full((3,), 1.3), rtol=0.01, atol=0)


def test_nothing_is_done_to_images_of_one_exposure_without_vignetting() -> None:
    light = estimation()
    walk(light, (1.0,) * 8, None)
    assert [light.of(keyframe) for keyframe in light.graph.keyframes] == [None] * 8
    view = TrainingView(light.graph.keyframes[3])
    uv = torch.tensor([[3, 4], [100, 80]])
    assert all(torch.equal(a, b) for a, b in zip(vars(_cast(view, uv)).values(), vars(cast(view, uv)).values(), strict=True))


def test_a_restored_estimation_goes_on_as_the_saved_one() -> None:
    light = estimation()
    walk(light, GAINS, VIGNETTE)
    again = LightEstimation(light.graph)
    again.restore(light.state())
    assert list(differences(light, again, "light")) == []
    for keyframe in light.graph.keyframes:
        one, other = light.of(keyframe), again.of(keyframe)
        assert one is not None and other is not None
        assert torch.equal(one.gain, other.gain) and torch.equal(one.offset, other.offset) and one.vignette == other.vignette


def test_comparisons_at_wrong_poses_are_forgotten() -> None:
    light = estimation()
    walk(light, GAINS, None)
    for keyframe in light.graph.keyframes[:4]:
        keyframe.edges = {i for i in keyframe.edges if i < 4}
    for keyframe in light.graph.keyframes[4:]:
        keyframe.edges = {i for i in keyframe.edges if i >= 4}
    light.on_split()
    assert {(a < 4, b < 4) for a, b in light.state()["pairs"]} == {(True, True), (False, False)}


def scene_colours() -> Tensor:
    """What the map is shown of a keyframe that was recorded with a gain of 1.25."""
    light = estimation()
    walk(light, (1.0, 1.25, 1.0, 1.25), None)
    keyframe = light.graph.keyframes[1]
    uv = torch.tensor([[20, 30], [80, 60], [140, 100]])
    return _cast(TrainingView(keyframe, light.later(keyframe)), uv).colour / keyframe.colour[uv[:, 1], uv[:, 0]]


def test_the_map_learns_colours_at_the_first_exposure() -> None:
    compiled = scene_colours()
    torch.testing.assert_close(compiled, torch.full((3, 3), 0.8), rtol=0.02, atol=0)
    with plain_torch():
        torch.testing.assert_close(scene_colours(), compiled, rtol=1e-5, atol=0)


def test_light_is_part_of_the_fast_system_alone() -> None:
    fast, paper = System(FAST), System(replace(PAPER, device="cpu"))
    assert any(isinstance(hook, LightEstimation) for hook in fast.hooks)
    assert fast.mapper.light == fast.light.later
    assert not any(isinstance(hook, LightEstimation) for hook in paper.hooks)
    assert isinstance(Slam(FAST).state()["parts"]["back_end.hooks.0"], dict)


def test_the_vignette_is_told_when_it_changes_noticeably_and_again_after_a_restore() -> None:
    told = list[Vignette | None]()
    light = LightEstimation(KeyframeGraph(replace(FAST.keyframes, cull=1.0)), told.append)
    walk(light, GAINS, VIGNETTE)
    assert 1 <= len(told) <= 4  # of eight keyframes
    last = told[-1]
    assert last is not None and light.vignette is not None and not differ(last, light.vignette)
    again = list[Vignette | None]()
    LightEstimation(light.graph, again.append).restore(light.state())
    assert again == [last]


def test_vignettes_differ_from_one_percent_on() -> None:
    assert not differ(None, None)
    assert not differ(Vignette((-0.009, 0.0)), None)
    assert differ(Vignette((-0.011, 0.0)), None)
    assert differ(Vignette((-0.1, 0.1)), None)  # the corner is as bright as the middle, what lies between is not


def test_brightness_is_compared_without_the_vignetting() -> None:
    bright, dim = (wall(1.0, 0.0, 0, lens) for lens in (None, VIGNETTE))
    full, unchanged = (pyramid(view.colour, CAMERA, height=60, levels=2) for view in (bright, dim))
    restored = pyramid(dim.colour, CAMERA, height=60, levels=2, vignette=VIGNETTE)
    for i, level in enumerate(full):
        torch.testing.assert_close(restored[i].luminance, level.luminance, rtol=0, atol=0.01)
        assert float((unchanged[i].luminance - level.luminance).abs().max()) > 0.05


def test_the_aligner_forgets_images_with_the_vignetting() -> None:
    aligner = System(FAST).aligner
    view = wall(1.0, 0.0, 0, VIGNETTE)
    before, marks = aligner.appearances.of(view), aligner.appearances.landmarks(view)
    aligner.appearances.take_out(VIGNETTE)
    after = aligner.appearances.of(view)
    assert float((after.levels[0].luminance / before.levels[0].luminance).max()) > 1.3
    assert aligner.appearances.landmarks(view) is not marks


def test_a_rendered_image_is_compared_at_the_exposure_of_the_recorded_one() -> None:
    rendered = np.random.default_rng(0).uniform(0.2, 0.7, (20, 30, 3))
    recorded = 1.2 * rendered + np.array([0.01, 0.0, -0.02])
    counts = np.ones((20, 30), bool)
    counts[:5] = False
    recorded[:5] = 0
    np.testing.assert_allclose(matched_exposure(rendered, recorded, counts)[5:], recorded[5:], atol=1e-6)
    assert np.array_equal(matched_exposure(rendered, recorded, np.zeros((20, 30), bool)), rendered.astype(np.float32))
