"""Surfaces continued: a floor that a body uncovered goes on, and the body that stands on it does not."""

import numpy as np

from idfslam.compute.backend import plain_torch
from idfslam.segmentation.smooth_continuation import continued, valleys

FOCAL, HEIGHT = 93.3, 1.4  # [cells], [m] of a camera above the floor
ROWS = np.arange(80)[:, None] - 19.5  # below the horizon


def floor() -> np.ndarray:
    """(80, 107) [m] the depth of a floor; none above the horizon."""
    depth = np.where(ROWS > 20, FOCAL * HEIGHT / np.maximum(ROWS, 1), 0).astype(np.float32)
    return np.tile(depth, (1, 107))


def test_a_valley_lies_where_an_upright_body_meets_the_floor_and_none_on_either() -> None:
    depth = floor()
    depth[20:61, 50:60] = depth[61, 0]
    found = valleys(depth)
    assert found[61, 50:60].all()
    assert not found[:61, 50:60].any()
    assert not valleys(floor()).any()


def test_a_floor_goes_on_where_it_was_hidden() -> None:
    depth, stays = floor(), np.zeros((80, 107), np.bool_)
    stays[:, :40] = stays[:, 70:] = depth[:, :1] > 0
    found = continued(stays, np.ones_like(stays), depth)
    np.testing.assert_array_equal(found, depth > 0)


def test_a_body_on_the_floor_is_none_of_it() -> None:
    depth, body = floor(), np.zeros((80, 107), np.bool_)
    body[20:61, 50:60] = True  # it stands on the floor at row 61, upright
    depth[body] = depth[61, 0]
    stays = (depth > 0) & ~body
    stays[:, 45:65] = False
    found = continued(stays, np.ones_like(stays), depth)
    assert not found[20:59, 50:60].any()
    assert found[61:, 45:65].all()
    assert found[41:60, 45:50].all()


def test_nothing_goes_on_where_it_may_not() -> None:
    depth, stays = floor(), np.zeros((80, 107), np.bool_)
    stays[:, :40] = depth[:, :1] > 0
    np.testing.assert_array_equal(continued(stays, np.zeros_like(stays), depth), stays)


def test_the_plain_form_agrees() -> None:
    depth = floor() + np.float32(0.01) * np.random.default_rng(0).standard_normal((80, 107), np.float32)
    stays = np.zeros((80, 107), np.bool_)
    stays[:, :40] = depth[:, :40] > 0.1
    found = continued(stays, np.ones_like(stays), depth)
    with plain_torch():
        np.testing.assert_array_equal(continued(stays, np.ones_like(stays), depth), found)


def test_a_few_cells_that_stay_do_not_make_scene_of_a_body() -> None:
    """An earlier view missed a part of her. A wall of which as much was seen is continued."""
    depth, stays = np.full((80, 107), 3.0, np.float32), np.zeros((80, 107), np.bool_)
    depth[20:60, 40:60] = 1.5
    stays[20:25, 40:60] = True  # an eighth of the body
    stays[:, :15] = stays[:, 70:] = True  # more than half of the wall
    found = continued(stays, np.ones_like(stays), depth)
    np.testing.assert_array_equal(found[20:60, 40:60], stays[20:60, 40:60])
    assert found[:, :40].all() and found[:, 60:].all()
