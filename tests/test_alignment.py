"""Alignment of frames to a map: the compiled normal equations, the way back to the truth, and what it says where it cannot know."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from helpers.three_walls import CAMERA, CONFIG, CORNER, EYE, WALL, aligner, error, pose, taught, view, with_depth, without_depth
from idfslam.alignment.alignment import Alignment
from idfslam.alignment.depth_term import depth_term, plain_depth_term
from idfslam.alignment.gauss_newton import damped_step, plain_damped_step
from idfslam.alignment.normals import plain_smoothed, smoothed_normals
from idfslam.alignment.surface import compiled_surface, plain_surface
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe
from idfslam.mapping.mapper import Mapper


@pytest.fixture(scope="module")
def corner() -> Mapper:
    return taught(CORNER)


@pytest.fixture(scope="module")
def wall() -> Mapper:
    return taught(WALL)


@pytest.mark.parametrize("patch", [1, 7])
def test_the_compiled_points_are_the_plain_ones(patch: int) -> None:
    generator = torch.Generator().manual_seed(0)
    depth = 1 + torch.rand(CAMERA.height, CAMERA.width, generator=generator)
    depth[torch.rand(depth.shape, generator=generator) < 0.3] = 0
    jitter = torch.randint(patch, (2, CAMERA.height // patch, CAMERA.width // patch), generator=generator)
    found, plain = compiled_surface(depth, CAMERA, jitter, patch), plain_surface(depth, CAMERA, jitter, patch)
    assert torch.equal(found.patches, plain.patches)
    torch.testing.assert_close(found.sigma, plain.sigma, rtol=1e-6, atol=0)
    torch.testing.assert_close(found.points, plain.points)


@pytest.mark.parametrize("scale", [1.0, 1e-9])
def test_the_compiled_step_is_the_plain_one(scale: float) -> None:
    generator = torch.Generator().manual_seed(0)
    J = torch.randn(40, 6, generator=generator, dtype=torch.float64)
    J[:, 0] *= 0.01  # a direction that little is known of
    H, b = J.T @ J, scale * torch.randn(6, generator=generator, dtype=torch.float64)
    start, before = se3.exp(torch.randn(6, generator=generator, dtype=torch.float64)), 0.01 * torch.ones(6, dtype=torch.float64)
    T, change, plain_T, plain_change = start.clone(), before.clone(), start.clone(), before.clone()
    largest = damped_step(H, b, 40.0, 2.0, 0.008, change, T)
    assert largest == pytest.approx(plain_damped_step(H, b, 40.0, 2.0, 0.008, plain_change, plain_T))
    torch.testing.assert_close(change, plain_change)
    torch.testing.assert_close(T, plain_T)
    assert not torch.equal(T, start)


def test_the_compiled_normal_equations_are_the_plain_ones() -> None:
    generator = torch.Generator().manual_seed(0)
    turned = 3 * torch.randn(500, 3, generator=generator)
    normal, slope = F.normalize(torch.randn(500, 3, generator=generator), dim=-1), 1.5 * torch.rand(500, generator=generator)
    distance, sigma = 0.05 * torch.randn(500, generator=generator), 1 + 5 * torch.rand(500, generator=generator)
    found = depth_term(turned, distance, normal, slope, sigma, 0.06, 0.01, 4.0)
    plain = plain_depth_term(turned, distance, normal, slope, sigma, 0.06, 0.01, 4.0)
    assert 0.3 < plain.overlap < 0.9
    for name in ("weight", "overlap", "rmse", "radius"):
        assert getattr(found, name) == pytest.approx(getattr(plain, name), rel=1e-4)
    torch.testing.assert_close(found.H, plain.H, rtol=0, atol=1e-4 * float(plain.H.abs().max()))
    torch.testing.assert_close(found.b, plain.b, rtol=0, atol=1e-4 * float(plain.b.abs().max()))


def rough_wall(angle: float, *, corner: bool = False) -> tuple[Tensor, Tensor, Tensor]:
    """Points of a wall in 12 x 16 patches, some empty, the gradient off by `angle` [rad] to random sides; a corner: two walls."""
    generator = torch.Generator().manual_seed(0)
    v, u = torch.meshgrid(torch.arange(12.0), torch.arange(16.0), indexing="ij")
    points = torch.stack([0.02 * u, 0.02 * v, torch.ones_like(u)], -1)
    normal = torch.tensor([0.0, 0.0, -1.0]).expand(12, 16, 3).clone()
    if corner:
        points[:, 8:, 0], points[:, 8:, 2] = 0.15, 1 - 0.02 * (u[:, 8:] - 7)
        normal[:, 8:] = torch.tensor([-1.0, 0.0, 0.0])
    normal = F.normalize(normal + angle * torch.randn(12, 16, 3, generator=generator), dim=-1)
    known = torch.rand(12, 16, generator=generator) > 0.1
    patches = torch.where(known, known.flatten().cumsum(0).view(12, 16) - 1, -1).int()
    return points[known], 0.8 * normal[known], patches


@pytest.mark.parametrize("corner", [False, True])
def test_the_compiled_smoothing_is_the_plain_one(corner: bool) -> None:
    points, gradient, patches = rough_wall(0.1, corner=corner)
    normal, slope = smoothed_normals(points, gradient, patches)
    torch.testing.assert_close(slope, torch.full((len(points),), 0.8), rtol=1e-5, atol=0)
    torch.testing.assert_close(normal, plain_smoothed(points, gradient / 0.8, patches), rtol=0, atol=1e-5)


def test_smoothing_evens_a_wall_and_keeps_an_edge() -> None:
    # The mean of about 22 normals, each off by 0.1 rad to either side, is off by a fifth of that
    points, gradient, patches = rough_wall(0.1)
    before, after = (n[:, :2].square().mean() ** 0.5 for n in (gradient / 0.8, smoothed_normals(points, gradient, patches)[0]))
    assert float(before) == pytest.approx(0.1, rel=0.1)
    assert float(after) < 0.04
    points, gradient, patches = rough_wall(0.02, corner=True)
    normal = smoothed_normals(points, gradient, patches)[0]
    assert float((normal * gradient / 0.8).sum(-1).min()) > 0.99  # at right angles nothing mixes


def test_fewer_points_keep_their_patches(corner: Mapper) -> None:
    seen = view(CORNER, EYE)
    surface = aligner(corner).surface(seen.images, seen.camera)
    third = surface.every(3)
    torch.testing.assert_close(third.points, surface.points[::3])
    known = third.patches >= 0
    torch.testing.assert_close(third.points[third.patches[known].long()], surface.points[surface.patches[known].long()])
    assert int(known.sum()) == len(third.points)


def test_little_depth_is_looked_at_closely(corner: Mapper) -> None:
    whole = view(CORNER, EYE)
    part = torch.zeros_like(whole.depth)
    part[40:60, 40:80] = whole.depth[40:60, 40:80]
    small = with_depth(whole, part)
    judge = aligner(corner, replace(CONFIG, points=800))
    assert len(judge.surface(small.images, small.camera).points) == 800  # every pixel of 20 x 40
    assert 600 < len(judge.surface(whole.images, whole.camera).points) < 1000


def test_normal_equations_of_one_point_by_hand() -> None:
    # At (1, 2, 3), 1 cm before a surface with normal (0, 0, 1): J = (0, 0, 1, 2, -1, 0), as (1, 2, 3) x (0, 0, 1) = (2, -1, 0).
    # Robust scale 0.01 * 2 = 0.02, so that the kernel is 1 + 1/4, and w = 1 / (1.25^2 * 2^2) = 0.16.
    one = torch.tensor
    system = depth_term(one([[1.0, 2.0, 3.0]]), one([0.01]), one([[0.0, 0.0, 1.0]]), one([1.0]), one([2.0]), 0.06, 0.01, 4.0)
    J = torch.tensor([0, 0, 1, 2, -1, 0], dtype=torch.float64)
    torch.testing.assert_close(system.H, 0.16 * torch.outer(J, J), rtol=1e-5, atol=1e-7)
    torch.testing.assert_close(system.b, -0.16 * 0.01 * J, rtol=1e-5, atol=1e-7)
    assert (system.weight, system.overlap, system.rmse) == pytest.approx((0.16, 1.0, 0.01))


def test_unknown_space_counts_for_nothing() -> None:
    # Too far from the surface, and where the map has no slope.
    system = depth_term(
        torch.ones(2, 3),
        torch.tensor([0.055, 0.0]),
        torch.tensor([[0, 0, 1.0], [0, 0, 1.0]]),
        torch.tensor([1.0, 0.1]),
        torch.ones(2),
        0.06,
        0.01,
        4.0,
    )
    assert (system.weight, system.overlap) == (0.0, 0.0)
    assert not system.H.any()


@pytest.mark.parametrize("offset", [(0.03, -0.02, 0.02, 0.01, -0.02, 0.015), (-0.02, 0.01, -0.02, -0.01, 0.01, -0.01)])
def test_a_displaced_pose_comes_back(corner: Mapper, offset: tuple[float, ...]) -> None:
    truth = pose(0.03, 0.02, 0.02, 0.01, 0.02, 0.0)
    found = aligner(corner).align(view(CORNER, truth), truth @ pose(*offset), [view(CORNER, EYE)])
    assert found.status is Status.OK
    metres, degrees = error(found.T_wc, truth)
    assert metres < 0.002
    assert degrees < 0.1
    assert found.overlap > 0.9
    assert found.score > 0
    torch.testing.assert_close(found.T_wc[:3, :3] @ found.T_wc[:3, :3].T, torch.eye(3, dtype=torch.float64))


def test_depth_alone_decides_in_a_corner(corner: Mapper) -> None:
    truth = pose(0.03, 0.02, 0.02, 0.01, 0.02, 0.0)
    found = aligner(corner).align(view(CORNER, truth), truth @ pose(0.01, -0.01, 0.01, 0.005, 0, 0.005), [])
    assert found.status is Status.OK
    assert error(found.T_wc, truth)[0] < 0.006
    assert found.photometric_error == 0.0


def test_depth_alone_must_tell_more_than_the_noise_of_normals(corner: Mapper) -> None:
    """Noise gives twice the limit of a degenerate direction: depth that is compared with no image is degenerate below three times it."""
    told = aligner(corner).align(view(CORNER, EYE), EYE, []).min_eigenvalue
    for times, status in ((2.9, Status.DEGENERATE), (3.1, Status.OK)):
        config = replace(CONFIG, min_eigenvalue=told / times)
        assert aligner(corner, config).align(view(CORNER, EYE), EYE, []).status is status


def test_a_bare_wall_is_degenerate_and_the_images_decide(wall: Mapper) -> None:
    truth = pose(0.03, 0.02, 0.01, 0, 0, 0)
    guess = truth @ pose(0.015, -0.01, 0.01, 0, 0, 0)
    config = replace(CONFIG, min_eigenvalue=3e-3)  # so few steps leave the map's wall a little wavy: the corner has 17e-3
    blind = aligner(wall, config).align(view(WALL, truth), guess, [])
    assert blind.status is Status.DEGENERATE
    assert float(blind.T_wc[2, 3] - truth[2, 3]) == pytest.approx(0, abs=0.003)  # across the wall
    assert error(blind.T_wc, truth)[0] > 0.01  # along it the guess stands
    seen = aligner(wall, config).align(view(WALL, truth), guess, [view(WALL, EYE)])
    assert seen.status is Status.DEGENERATE
    assert error(seen.T_wc, truth)[0] < 0.003


def test_what_a_bare_wall_leaves_open_is_held_to_the_registration(wall: Mapper) -> None:
    slid = pose(0.03, -0.02, 0, 0, 0, 0)
    alone = aligner(wall).align(view(WALL, EYE), EYE, [], max_guess_error_px=0.0)
    held = aligner(wall).align(view(WALL, EYE), slid, [], registered=True)
    assert error(alone.T_wc, EYE)[0] < 0.005
    assert error(held.T_wc, slid)[0] < 0.005


def test_in_a_corner_it_has_the_lesser_say(corner: Mapper) -> None:
    off = pose(0.03, -0.02, 0.02, 0, 0, 0)
    held = aligner(corner).align(view(CORNER, EYE), off, [], registered=True)
    assert error(held.T_wc, EYE)[0] < 0.5 * error(off, EYE)[0]


def test_without_depth_and_references_it_is_lost(corner: Mapper) -> None:
    guess = pose(0.1, 0, 0, 0, 0, 0)
    found = aligner(corner).align(without_depth(view(CORNER, EYE)), guess, [])
    assert found.status is Status.LOST
    assert found.score == 0
    assert torch.equal(found.T_wc, guess)


@pytest.fixture(scope="module")
def room() -> SyntheticRoom:
    return SyntheticRoom(frames=30, width=320, height=240)


def seen(room: SyntheticRoom, i: int, *, depth: bool = True, colour: bool = True) -> Keyframe:
    """A view of a furnished room at its true pose."""
    frame = room[i]
    images = torch.from_numpy(frame.depth * depth), torch.from_numpy(frame.colour * colour)
    return Keyframe(frame, torch.from_numpy(room.ground_truth[i]), *images)


def test_without_depth_the_images_give_the_pose(corner: Mapper, room: SyntheticRoom) -> None:
    reference, blind = seen(room, 0), seen(room, 4, depth=False)
    judge = aligner(corner)
    judge.usual_error.expect([0.02])
    found = judge.align(blind, reference.T_wk, [reference])
    off, turn = error(found.T_wc, blind.T_wk)
    assert found.status is Status.DEGENERATE
    assert off < 0.003 and turn < 0.1  # [m], [degrees]; the camera has moved by 5 cm and 4 degrees
    assert error(reference.T_wk, blind.T_wk)[0] > 0.03


def test_without_depth_a_black_image_is_lost(corner: Mapper, room: SyntheticRoom) -> None:
    reference = seen(room, 0)
    assert aligner(corner).align(seen(room, 0, depth=False, colour=False), reference.T_wk, [reference]).status is Status.LOST


def test_the_covariance_grows_where_nothing_measures(corner: Mapper, wall: Mapper) -> None:
    seen = aligner(corner).align(view(CORNER, EYE), EYE, []).covariance
    bare = aligner(wall).align(view(WALL, EYE), EYE, []).covariance
    assert seen is not None and bare is not None
    assert float(torch.linalg.eigvalsh(seen)[-1]) ** 0.5 < 0.01  # [m]
    assert float(torch.linalg.eigvalsh(bare)[-1]) > 10 * float(torch.linalg.eigvalsh(seen)[-1])


def test_where_the_map_knows_no_surface_it_is_lost(corner: Mapper) -> None:
    nowhere = aligner(corner)
    nowhere.query = lambda points: (torch.full((len(points),), 0.06), torch.zeros(len(points), 3))
    found = nowhere.align(view(CORNER, EYE), EYE, [])
    assert (found.status, found.overlap, found.score) == (Status.LOST, 0.0, 0.0)


def test_two_alignments_are_the_same(corner: Mapper) -> None:
    once, again = (aligner(corner).align(view(CORNER, EYE), pose(0.01, 0, 0, 0, 0, 0), [view(CORNER, EYE)]) for _ in range(2))
    assert torch.equal(once.T_wc, again.T_wc)


def test_doubt(corner: Mapper) -> None:
    judge = aligner(corner, replace(CONFIG, doubtful_overlap=0.6))
    good = Alignment(EYE, Status.OK, 0.9, 0.004, 0.1, 0.02, 0.8, None, 5, displacement=0.01)
    assert judge.is_doubtful(good)  # 0.01 is more than twice the least displacement, and nothing is known of this recording yet
    judge.accept(good, EYE)
    assert not judge.is_doubtful(good)
    assert not judge.is_doubtful(replace(good, displacement=0.019))
    assert judge.is_doubtful(replace(good, displacement=0.03))
    assert not judge.is_doubtful(replace(good, displacement=0.0))  # no landmark in view says nothing
    assert judge.is_doubtful(replace(good, overlap=0.5))
    assert judge.is_doubtful(replace(good, status=Status.LOST))


@pytest.mark.parametrize(
    ("shift", "turn", "unsure"),
    [(0.02, 0.01, False), (0.03, 0.01, True), (0.02, 0.021, True)],  # [m], [rad] standard deviation along each of three axes
)
def test_an_alignment_is_unsure_from_five_centimetres_or_two_degrees_on(shift: float, turn: float, unsure: bool) -> None:
    """In all: 3.5 cm and 1 degree, 5.2 cm, 2.1 degrees. One whose covariance is not known is not unsure."""
    found = Alignment(EYE, Status.OK, 0.9, 0.004, 0.1, 0.02, 0.8, None, 5)
    variances = torch.tensor([shift**2] * 3 + [turn**2] * 3, dtype=torch.float64)
    assert replace(found, covariance=torch.diag(variances)).is_unsure is unsure
    assert not found.is_unsure


def test_the_usual_photometric_error(corner: Mapper) -> None:
    judge = aligner(corner, replace(CONFIG, doubtful_brightness=1.5, colour_noise=0.01))
    good = Alignment(EYE, Status.OK, 0.9, 0.004, 0.1, 0.02, 0.8, None, 5)
    assert judge.usual_error.doubtful == pytest.approx(0.015)  # 1.5 times the least noise: nothing is known of this recording yet
    judge.accept(good, EYE)
    assert judge.usual_error.doubtful == pytest.approx(0.03)
    judge.accept(replace(good, photometric_error=0.04), EYE)  # counts as 0.03, at a lower rate: the usual error is 0.0203
    assert judge.usual_error.doubtful == pytest.approx(1.5 * 0.0203)
    judge.accept(replace(good, photometric_error=0.0), EYE)  # no landmark in view says nothing
    assert judge.usual_error.doubtful == pytest.approx(1.5 * 0.0203)


def test_how_far_off_a_prediction_is_decides_on_the_first_image(corner: Mapper) -> None:
    # Three levels of two steps each, each good for 1.5 of its own pixels: 1.5, 3 and 6 of the finest's
    judge = aligner(corner, replace(CONFIG, level_reach=1.5, steps_a_level=2))
    assert [judge._first_step(error) for error in (None, 100.0, 3.1, 3.0, 1.6, 1.5, 0.0)] == [0, 0, 0, 2, 2, 4, 4]


def test_predictions_are_expected_to_be_as_far_off_as_lately(corner: Mapper) -> None:
    judge = aligner(corner, replace(CONFIG, level_reach=1.5))
    good = Alignment(EYE, Status.OK, 0.9, 0.004, 0.1, 0.02, 0.8, None, 5, focal=100.0, radius=2.0)
    off = lambda x, turn: se3.exp(torch.tensor([x, 0, 0, 0, turn, 0], dtype=torch.float64))  # noqa: E731
    assert judge.expected is None
    judge.accept(good, off(0.02, 0.0))  # 2 cm at 2 m are 0.01 of a focal length: 1 pixel, and half as much again
    assert judge.expected == pytest.approx(1.5)
    judge.accept(good, off(0.0, 0.02))  # 2 pixels
    assert judge.expected == pytest.approx(3.0, rel=1e-3)
    judge.accept(good, EYE)
    assert judge.expected == pytest.approx(0.95 * 3.0, rel=1e-3)
    # What was to be within 2 pixels, and moved 4 of them, may have missed
    assert judge.unexpected(good, off(0.09, 0.0), 2.0) and not judge.unexpected(good, off(0.07, 0.0), 2.0)
    assert judge.unexpected(good, off(0.07, 0.0), 0.1) and not judge.unexpected(good, off(0.05, 0.0), 0.1)  # a level's reach at least
    assert not judge.unexpected(good, off(9.0, 0.0), None)


def test_from_the_finest_images_it_is_as_exact(corner: Mapper) -> None:
    whole = aligner(corner).align(view(CORNER, EYE), off_by_a_little(), [view(CORNER, EYE)])
    near = aligner(corner).align(view(CORNER, EYE), off_by_a_little(), [view(CORNER, EYE)], max_guess_error_px=1.0)
    assert near.iterations < whole.iterations
    assert error(near.T_wc, EYE)[0] < 0.002 and error(whole.T_wc, EYE)[0] < 0.002


def off_by_a_little() -> Tensor:
    return se3.exp(torch.tensor([0.004, -0.003, 0.004, 0.002, -0.002, 0.001], dtype=torch.float64))


def test_score_prefers_overlap_closeness_and_colour() -> None:
    good = Alignment(EYE, Status.OK, 0.9, 0.004, 0.1, 0.02, 0.8, None, 5)
    for worse in ({"overlap": 0.8}, {"rmse": 0.005}, {"photometric_error": 0.03}, {"in_view": 0.5}, {"status": Status.LOST}):
        assert replace(good, **worse).score < good.score
