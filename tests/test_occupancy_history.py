"""What stored views show of things that did not stay: votes of space worked out by hand, in both forms, and a body that leaves."""

import numpy as np
import pytest
from numpy.typing import NDArray

from idfslam.compute.backend import plain_torch
from idfslam.geometry.camera import Camera
from idfslam.segmentation.coarse_view import coarse_view
from idfslam.segmentation.occupancy_history import OccupancyHistory, StoredView

CAMERA = Camera(320, 240, 280.0, 280.0, 159.5, 119.5)
BODY = slice(20, 60), slice(40, 60)  # cells


def wall(number: int, *, body: float = 0.0, x: float = 0.0) -> StoredView:
    """A view of a wall at 3 m from x [m], with a body of a depth [m] in the same pixels."""
    depth = np.full((240, 320), 3.0, np.float32)
    if body:
        depth[60:180, 120:180] = body
    return posed(depth, number, x=x)


def posed(depth: NDArray[np.float32], number: int, *, x: float = 0.0) -> StoredView:
    """A view with a depth (240, 320) [m] from x [m]."""
    T_wc = np.eye(4)
    T_wc[0, 3] = x
    return StoredView(coarse_view(depth, np.zeros((240, 320, 3), np.float32), CAMERA), T_wc, number)


def test_who_stood_there_from_the_first_frame_is_found_once_she_has_left() -> None:
    stands = [wall(5 * i, body=1.5) for i in range(12)]
    history = OccupancyHistory.of([*stands, wall(65), wall(70)])
    for view in (stands[0], stands[-1]):
        moving = history.moving(view)
        assert moving[BODY].all()
        assert moving.sum() == 40 * 20
    assert not history.moving(wall(70)).any()
    assert not OccupancyHistory.of([*stands, wall(65)]).moving(stands[0]).any()  # one view alone may be wrong


def test_a_tenth_of_the_views_must_have_seen_through() -> None:
    stands = [wall(i, body=1.5) for i in range(40)]
    assert not OccupancyHistory.of([*stands, wall(65), wall(70)]).moving(stands[0]).any()  # 2 of 42
    assert OccupancyHistory.of([*stands, *(wall(65 + i) for i in range(5))]).moving(stands[0])[BODY].all()  # 5 of 45


def test_legs_that_no_view_saw_through_belong_to_the_body_that_left_and_a_box_that_it_touched_does_not() -> None:
    depth = np.full((240, 320), 3.0, np.float32)
    depth[60:180, 180:240] = 1.55  # a box beside it
    left = depth.copy()
    left[90:, :180] = 0  # later views look at the box and at the upper quarter of the place where it stood
    depth[60:180, 120:180] = 1.5
    stands, later = [posed(depth, 5 * i) for i in range(12)], [posed(left, 65), posed(left, 70)]
    moving = OccupancyHistory.of([*stands, *later]).moving(stands[6])
    assert moving[BODY].all()
    assert moving.sum() == 40 * 20


@pytest.mark.parametrize(("last", "moves"), [(100, True), (101, False)])
def test_what_stands_for_90_frames_where_space_was_free_is_part_of_the_scene(last: int, moves: bool) -> None:
    came = [wall(20, body=1.5), wall(last, body=1.5)]
    assert OccupancyHistory.of([wall(10), wall(11), *came]).moving(came[0]).any() == moves


def test_nothing_moves_in_a_static_scene_seen_from_many_places() -> None:
    views = [wall(i, x=0.05 * i) for i in range(20)]
    history = OccupancyHistory.of(views)
    assert not any(history.moving(view).any() for view in views)
    assert not history.through.any()
    assert history.last.max() == 19


def test_without_views_nothing_is_known() -> None:
    assert not OccupancyHistory.of([]).moving(wall(0)).any()


def test_the_plain_form_agrees() -> None:
    generator = np.random.default_rng(0)
    views = [wall(i, body=float(generator.uniform(1, 2.9)), x=float(generator.uniform(-0.3, 0.3))) for i in range(6)]
    compiled = OccupancyHistory.of(views)
    with plain_torch():
        plain = OccupancyHistory.of(views)
    for name in ("keys", "through", "seen", "free", "first", "last"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(compiled, name))
    assert compiled.through.any()
