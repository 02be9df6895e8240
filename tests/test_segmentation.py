"""The segmentation of what moves: votes by free space against numbers worked out by hand, regions, and views remembered and seen again."""

from functools import cache

import numpy as np
import pytest

from idfslam.compute.backend import plain_torch
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.segmentation.carrying import BESIDE, carried_with_ages
from idfslam.segmentation.coarse_view import CoarseView, cell_size, cells_camera, coarse_view, in_pixels, thinned
from idfslam.segmentation.constants import NEVER, SIGMAS, SLACK
from idfslam.segmentation.free_space import PosedView, plain_vote, sigma, votes
from idfslam.segmentation.memory import Memory
from idfslam.segmentation.region_growing import grown
from idfslam.segmentation.remembered import Remembered
from idfslam.segmentation.segmenter import Segmenter
from idfslam.segmentation.witnesses import Witnesses

CAMERA = Camera(320, 240, 280.0, 280.0, 159.5, 119.5)


def wall(z: float, *, body: float = 0.0, columns: slice = slice(120, 180), grey: float = 0.5) -> CoarseView:
    """A view of a wall, with a body before it in rows 60 to 179 of these columns if it has a depth."""
    depth, colour = np.full((240, 320), z, np.float32), np.full((240, 320, 3), grey, np.float32)
    if body:
        depth[60:180, columns] = body
    return coarse_view(depth, colour, CAMERA)


def posed(view: CoarseView, *, x: float = 0.0, moving: bool = False, testifies: bool = True) -> PosedView:
    T = np.eye(4)
    T[0, 3] = x
    return PosedView(view, T, np.full(view.depth.shape, moving), testifies)


# ----- coarse views


def test_cells() -> None:
    assert cell_size(CAMERA) == 3
    small = cells_camera(CAMERA)
    assert (small.width, small.height) == (107, 80)
    assert small.cx == pytest.approx(160 / 3 - 0.5)
    cells = np.zeros((80, 107), np.bool_)
    cells[1, 106] = True
    pixels = in_pixels(cells, CAMERA)
    assert pixels.shape == (240, 320)
    assert pixels[3:6, 318:].all()
    assert pixels.sum() == 6  # the last column of cells is two pixels wide


def test_a_cell_has_its_median_and_the_extremes_around_it() -> None:
    depth, colour = np.full((240, 320), 2.0, np.float32), np.full((240, 320, 3), 0.5, np.float32)
    depth[30, 30], depth[31, 31], colour[32, 32] = 1.0, 0.0, 0.9
    view = coarse_view(depth, colour, CAMERA)
    assert view.depth[10, 10] == 2.0
    assert view.near[9:12, 9:12].tolist() == [[1.0] * 3] * 3
    assert view.near[8, 10] == 2.0
    assert view.bright[11, 11] == pytest.approx(0.9)
    assert view.brightness[10, 10] == pytest.approx(0.5 + 0.4 / 9)


@pytest.mark.parametrize("height", [240, 480, 484, 720])
def test_a_thinned_frame_has_the_same_cells(height: int) -> None:
    """Of 480 and 484 rows a cell has 6 pixels, of which 3 are read. Of 240 it has 3. Of 720 it has 9, and the last column is cut off."""
    generator = np.random.default_rng(0)
    camera = Camera(640, height, 525.0, 525.0, 319.5, height / 2 - 0.5)
    depth = generator.uniform(0, 4, (height, 640)).astype(np.float32) * (generator.random((height, 640)) > 0.1)
    frame = Frame(0, 0.0, generator.random((height, 640, 3), np.float32), depth, camera)
    small = thinned(frame)
    assert small.depth.shape[0] == {240: 240, 480: 240, 484: 242, 720: 720}[height]
    whole, part = (coarse_view(of.depth, of.colour, of.camera) for of in (frame, small))
    for name in ("depth", "near", "far", "brightness", "dark", "bright"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name))


def test_free_space_is_not_known_beside_holes() -> None:
    depth, colour = np.full((240, 320), 2.0, np.float32), np.full((240, 320, 3), 0.5, np.float32)
    depth[:, 150:] = 0
    view = coarse_view(depth, colour, CAMERA)
    assert np.isfinite(view.near[40, 48:52]).tolist() == [True, True, False, False]


# ----- votes


def test_a_body_before_a_wall_that_was_seen_moves() -> None:
    found = votes(wall(3.0, body=1.5), np.eye(4), [posed(wall(3.0))])
    assert found.moves[20:60, 40:60].all()
    assert found.moves.sum() == 40 * 20
    assert found.stays.sum() == 80 * 107 - 40 * 20


def test_what_was_seen_through_moves_in_the_earlier_view() -> None:
    found = votes(wall(3.0, body=1.5), np.eye(4), [posed(wall(3.0)), posed(wall(3.0)), posed(wall(3.0, body=1.5))])
    assert found.moves[20:60, 40:60].all()  # two saw through it, one saw it
    assert not votes(wall(3.0, body=1.5), np.eye(4), [posed(wall(3.0)), posed(wall(3.0, body=1.5))]).moves.any()


@pytest.mark.parametrize(("nearer", "moves"), [(-0.003, False), (0.003, True)])
def test_a_surface_moves_beyond_slack_and_noise(nearer: float, moves: bool) -> None:
    z = 3.0
    for _ in range(20):  # both readings have the noise of the body's depth
        z = 3.0 - SLACK - 2 * SIGMAS * float(sigma(np.array(z)))
    assert votes(wall(3.0, body=z - nearer), np.eye(4), [posed(wall(3.0))]).moves.any() == moves


def test_a_wrong_pose_is_no_mover() -> None:
    """All of a wall nearer by 8 cm: within 15 cm it counts as the same surface, and widens the margin."""
    assert not votes(wall(2.92), np.eye(4), [posed(wall(3.0))]).moves.any()
    assert not votes(wall(1.0), np.eye(4), [posed(wall(3.0))]).moves.any()  # everything at once: no view is believed


def test_brightness_contradicts() -> None:
    dark = wall(3.0, grey=0.5)
    bright = coarse_view(
        np.full((240, 320), 3.0, np.float32),
        np.linspace(0.2, 0.8, 320, dtype=np.float32)[None, :, None].repeat(3, 2).repeat(240, 0),
        CAMERA,
    )
    found = votes(dark, np.eye(4), [posed(bright)])
    assert 0.05 < found.seen.mean() < 0.3  # where it is about equally bright


def test_moving_cells_agree_but_do_not_hold() -> None:
    found = votes(wall(3.0), np.eye(4), [posed(wall(3.0), moving=True)])
    assert (found.seen == 0).all() and (found.agree == 1).all() and found.stays.all() and not found.held.any()
    assert not votes(wall(3.0), np.eye(4), [posed(wall(3.0), testifies=False)]).stays.any()


def test_what_stands_for_long_and_was_never_seen_through_since_stays() -> None:
    here, gone = wall(3.0, body=1.5), wall(3.0)
    old, still, nothing = posed(here, moving=True), np.eye(4), np.zeros((80, 107), np.bool_)
    old = PosedView(old.view, old.T_wc, old.moving, settles=True)
    before = PosedView(gone, still, nothing, settles=True)
    assert votes(here, still, [before]).moves.sum() == 40 * 20
    assert not votes(here, still, [before, old]).moves.any()
    assert votes(here, still, [before, old]).held[20:60, 40:60].all()
    since = PosedView(gone, still, nothing)
    assert votes(here, still, [before, old, since]).moves.sum() == 40 * 20  # she left, and is back


# ----- witnesses


def remembered(view: CoarseView, number: int, host: int = 0) -> Remembered:
    nothing = np.zeros(view.depth.shape, np.bool_)
    return Remembered(host, np.eye(4), view, nothing, True, nothing, number)


def test_views_that_saw_through_what_moves_are_asked_again() -> None:
    def pose_of(host: int) -> np.ndarray:
        T = np.eye(4)
        T[0, 3] = 0.1 * host
        return T

    views = [remembered(wall(3.0), number, host) for host, number in enumerate((0, 10, 20, 30, 40))]
    witnesses = Witnesses(pose_of)
    assert list(witnesses.nearest(np.eye(4), 50, [views])) == [0, 10]  # the most similar poses
    assert list(witnesses.asked(np.eye(4), 50, [views], moves=False)) == [0, 10]
    assert list(witnesses.asked(np.eye(4), 50, [views], moves=True)) == [0, 10, 40]  # and 20, 30 or 40 in turns
    moving, parts = np.zeros((80, 107), np.bool_), [np.zeros((80, 107), np.bool_) for _ in range(3)]
    moving[:10, :30] = True
    parts[0][:10, :20], parts[1][:10, 18:30], parts[2][:10, :22] = True, True, True
    witnesses.prove({10: parts[0], 20: parts[1], 30: parts[2]}, moving)
    assert witnesses.proven == [30, 20]  # 220 of 300 cells, then the other 80
    assert list(witnesses.asked(np.eye(4), 51, [views], moves=True)) == [0, 10, 20, 30, 40]
    assert 0 in witnesses.asked(pose_of(4), 95, [views], moves=False)  # it shows what stands for 90 frames
    far = np.eye(4)
    far[2, 3] = 3.0
    assert witnesses.asked(far, 51, [views], moves=True) == {}


@cache
def room(movers: str | None) -> SyntheticRoom:
    return SyntheticRoom(2, 300, 320, 240, noise=True, movers=movers)


def seen(recording: SyntheticRoom, i: int) -> CoarseView:
    frame = recording[i]
    return coarse_view(frame.depth, frame.colour, frame.camera)


@pytest.mark.parametrize("i", [0, 60, 200])
def test_plain_and_compiled_votes_agree(i: int) -> None:
    recording = room("people")
    view, other = seen(recording, i), seen(recording, i + 12)
    moving = np.zeros(view.depth.shape, np.bool_)
    moving[:30] = True
    b = PosedView(other, recording.ground_truth[i + 12], moving)
    T = np.linalg.inv(b.T_wc) @ recording.ground_truth[i]
    plain = [np.zeros(view.depth.shape, np.bool_) for _ in range(3)]
    known = plain_vote(view, b, T, *plain)
    compiled = votes(view, recording.ground_truth[i], [b])
    with plain_torch():
        by_hand = votes(view, recording.ground_truth[i], [b])
        again = seen(recording, i)
    np.testing.assert_allclose(again.near, view.near)
    np.testing.assert_allclose(again.brightness, view.brightness, atol=1e-6)
    assert known > 3000
    for name in ("through", "seen", "agree"):
        assert (getattr(compiled, name) != getattr(by_hand, name)).mean() < 1e-3


# ----- regions


def test_regions_grow_over_what_does_not_stay() -> None:
    depth, stays, seeds = np.full((40, 60), 2.0, np.float32), np.zeros((40, 60), np.bool_), np.zeros((40, 60), np.bool_)
    depth[:, 30:] = 3.0  # an edge
    stays[:10] = True
    seeds[19:27, 25:29] = True  # 32, as many as a region must have
    found = grown(seeds, stays, depth)
    with plain_torch():
        np.testing.assert_array_equal(found, grown(seeds, stays, depth))
    assert found[11:35, 25:29].all()  # eight cells up and down
    assert not found[:, 30:].any() and not found[:10].any()


def test_lone_seeds_and_small_regions_are_noise() -> None:
    depth, none = np.full((40, 60), 2.0, np.float32), np.zeros((40, 60), np.bool_)
    seeds, island = none.copy(), depth.copy()
    seeds[5, 5] = seeds[5, 6] = seeds[30, 30] = True
    assert not grown(seeds, none, depth).any()
    seeds[20:23, 20:23] = True
    island[20:23, 20:23] = 1.0
    assert not grown(seeds, none, island).any()


# ----- carrying


def test_cells_are_carried_to_where_another_camera_sees_them() -> None:
    view, cells, ages = wall(2.0), np.zeros((80, 107), np.bool_), np.full((80, 107), 7, np.int32)
    cells[40, 50] = True
    T_wc = np.eye(4)
    T_wc[2, 3], T_wc[0, 3] = 0.5, 2.0 * 1.5 / (280 / 3)  # half a metre nearer, and two cells (at 1.5 m) to the right
    near, out = carried_with_ages(view, np.eye(4), cells, ages, view.camera, T_wc)
    v, u = np.nonzero(np.isfinite(near))
    assert (v.min(), v.max(), u.min(), u.max()) == (39, 41, 46, 48)  # from (53.0 - 50) 2 / 1.5 = 4 cells left of the middle, two more
    assert near[40, 47] == pytest.approx(1.5)
    assert out[40, 47] == 7
    assert out[39, 46] == 7 + BESIDE
    assert out[0, 0] == NEVER
    with plain_torch():
        plain = carried_with_ages(view, np.eye(4), cells, ages, view.camera, T_wc)
    np.testing.assert_array_equal(plain[0], near)
    np.testing.assert_array_equal(plain[1], out)


# ----- views one after the other


def stands_from(start: int, frames: int) -> tuple[Segmenter, list[float]]:
    """The segmenter of a bolted camera before a wall, before which a body stands from a frame on; and how much of the body is masked."""
    segmenter, shares = Segmenter(Memory(lambda k: np.eye(4))), list[float]()
    for i in range(frames):
        cells = segmenter.segment(wall(3.0, body=1.5 if i >= start else 0.0), np.eye(4))
        segmenter.memory.add(segmenter.last, i // 10, np.eye(4), stored=i % 10 == 0)
        shares.append(float(cells[20:60, 40:60].mean()))
    return segmenter, shares


def test_who_stands_still_is_masked_for_three_seconds_and_is_then_part_of_the_scene() -> None:
    _, shares = stands_from(30, 150)
    assert shares[29] == 0.0
    assert min(shares[30:120]) == 1.0
    assert max(shares[140:]) == 0.0


def test_who_stops_where_no_view_saw_stays_masked_for_a_second() -> None:
    """She walks along the rays, so that she hid her later places herself: no view ever saw through them."""
    segmenter, shares = Segmenter(Memory(lambda k: np.eye(4))), list[float]()
    for i in range(90):
        cells = segmenter.segment(wall(3.0, body=1.0 + 0.03 * min(max(i - 10, 0), 20)), np.eye(4))
        segmenter.memory.add(segmenter.last, i // 10, np.eye(4), stored=i % 10 == 0)
        shares.append(float(cells[20:60, 40:60].mean()))
    assert max(shares[:10]) == 0.0
    assert min(shares[15:48]) > 0.8  # she stops at frame 30, and was found to move last at about 20
    assert max(shares[55:]) == 0.0


def test_a_view_at_its_predicted_pose_need_not_be_segmented_again() -> None:
    segmenter, _ = stands_from(30, 40)
    again, _ = stands_from(30, 40)
    view, T, off = wall(3.0, body=1.5, columns=slice(150, 210)), np.eye(4), np.eye(4)
    T[0, 3], off[0, 3] = 0.005, 0.02
    expected = segmenter.predict(view, np.eye(4))
    assert expected[20:60, 50:70].all()
    assert segmenter.confirm(off) is None
    confirmed = segmenter.confirm(T)
    assert confirmed is not None
    np.testing.assert_array_equal(confirmed, again.segment(view, np.eye(4)))
    assert segmenter.confirm(T) is None  # it was taken up


# ----- views of a room


def walked(recording: SyntheticRoom, frames: int, every: int = 15) -> tuple[Memory, list[float], list[float]]:
    """A memory that has seen the first frames at their true poses, and each frame's shares of right and of wrong moving pixels."""
    poses: list[np.ndarray] = []
    segmenter, right, wrong = Segmenter(Memory(lambda k: poses[k])), list[float](), list[float]()
    for i in range(frames):
        frame, T = recording[i], recording.ground_truth[i]
        cells = segmenter.segment(coarse_view(frame.depth, frame.colour, frame.camera), T)
        shown, truth = in_pixels(cells, frame.camera) & (frame.depth > 0), recording.moving(i) & (frame.depth > 0)
        right.append(float((shown & truth).sum() / max(truth.sum(), 1)))
        wrong.append(float((shown & ~truth).mean()))
        if i % every == 0:
            poses.append(T)
        segmenter.memory.add(segmenter.last, len(poses) - 1, np.linalg.inv(poses[-1]) @ T, stored=i % every == 0)
        segmenter.memory.segment_again(segmenter.last)
    return segmenter.memory, right, wrong


@pytest.mark.slow
def test_people_are_found_and_the_first_view_heals() -> None:
    recording = room("people")
    memory, right, wrong = walked(recording, 150)
    assert max(right[:40]) < 0.1  # nobody knows what stands there from the beginning and has not moved
    assert np.mean(right[100:]) > 0.6
    assert np.mean(wrong) < 0.01
    first = memory.keyframes[0]
    shown, truth = in_pixels(first.moving, recording.camera), recording.moving(0) & (recording[0].depth > 0)
    assert (shown & truth).sum() / (shown | truth).sum() > 0.5
    again = Memory(lambda k: np.eye(4))
    again.restore(memory.state())
    assert again.state()["counts"] == memory.state()["counts"]
    np.testing.assert_array_equal(again.keyframes[0].moving, first.moving)


@pytest.mark.slow
def test_nothing_moves_in_a_static_room() -> None:
    assert max(walked(room(None), 60)[2]) == 0
