"""What stands still in the image while all else moves: found without a pose, and told from a near thing of the scene with one."""

from dataclasses import replace

import numpy as np
import pytest

from idfslam.geometry.camera import Camera
from idfslam.segmentation.coarse_view import CoarseView, cells_camera, coarse_view
from idfslam.segmentation.image_standstill import at_same_place, is_carried, stands_still, without

CAMERA = Camera(320, 240, 288.5, 288.5, 159.5, 119.5)
NEAR, FAR = 0.5, 3.0  # [m]
V, U = np.mgrid[:240, :320].astype(np.float32)
BOX = (abs(U - 160) < 48) & (abs(V - 120) < 48)


def seen(shift: float, box_shift: float, gain: float = 1.0) -> CoarseView:
    """A textured box before a textured wall; both textures are moved along the rows by so many pixels. The box stays in its place."""

    def texture(u: np.ndarray, length: float) -> np.ndarray:
        return np.asarray(0.5 + 0.2 * np.sin(u / length) * np.cos(V / length))

    image = gain * np.where(BOX, texture(U + box_shift, 9), texture(U + shift, 13))
    depth = np.where(BOX, NEAR, FAR).astype(np.float32)
    view = coarse_view(depth, np.repeat(image[..., None], 3, -1).astype(np.float32), CAMERA)
    return replace(view, camera=cells_camera(CAMERA))


def moved(metres: float) -> np.ndarray:
    """The pose of a camera that has moved to the right."""
    T = np.eye(4)
    T[0, 3] = metres
    return T


LAYER = seen(0, 0).depth < 1


@pytest.mark.parametrize("gain", [1.0, 0.7])
@pytest.mark.parametrize(("shift", "box_shift", "still"), [(4, 0, True), (4, 24, False), (4, 4, False), (0, 0, False)])
def test_a_layer_that_moves_less_than_the_rest_stands_still(shift: float, box_shift: float, gain: float, still: bool) -> None:
    assert stands_still(seen(shift, box_shift, gain), seen(0, 0), LAYER) is still


def test_one_who_walks_is_not_all_of_the_rest() -> None:
    walks, stands, column = seen(4, 0), seen(0, 0), np.arange(LAYER.shape[1])
    in_a_third = replace(stands, brightness=np.where(column < 30, walks.brightness, stands.brightness))
    assert not stands_still(in_a_third, stands, LAYER)
    nearly_everywhere = replace(stands, brightness=np.where(column < 12, stands.brightness, walks.brightness))
    assert stands_still(nearly_everywhere, stands, LAYER)


def test_it_is_carried_if_a_part_of_the_scene_would_have_been_seen_elsewhere() -> None:
    metres = 4 * FAR / CAMERA.fx  # the wall moves by 4 px, and the box would move by 24
    now, before = seen(4, 0), seen(0, 0)
    assert is_carried(now, moved(metres), before, np.eye(4), LAYER)
    assert not is_carried(seen(4, 24), moved(metres), before, np.eye(4), LAYER)
    assert not is_carried(now, np.eye(4), before, np.eye(4), LAYER)  # a camera that stands: the box is where it would be


def test_the_layer_is_found_again_by_its_depth() -> None:
    before, now = seen(0, 0), seen(9, 0)
    cells = at_same_place(now, before, LAYER)
    assert (cells & LAYER).sum() == LAYER.sum()
    assert not (cells & ~LAYER).any()
    away = replace(now, depth=np.full_like(now.depth, FAR))
    assert not at_same_place(away, before, LAYER).any()
    hole = replace(now, depth=np.zeros_like(now.depth))
    np.testing.assert_array_equal(at_same_place(hole, before, LAYER), LAYER)


def test_a_view_without_it_has_no_readings_there() -> None:
    rest = without(seen(0, 0), LAYER)
    assert not rest.depth[LAYER].any()
    assert (rest.depth[~LAYER] == np.float32(FAR)).all()
    assert np.isinf(rest.near[LAYER]).all()
    assert rest.far.max() == np.float32(FAR)
