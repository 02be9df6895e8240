"""How much of a keyframe's correction the frame before it needs: by the evenness of motions written by hand."""

import numpy as np
import pytest

from idfslam.graph.shared_correction import places, shared, unevenness, usual_unevenness

STAMPS = np.arange(4) / 30


def along(*x: float) -> np.ndarray:
    """Poses (N, 4, 4) at these places [m] along the first axis."""
    poses = np.tile(np.eye(4), (len(x), 1, 1))
    poses[:, 0, 3] = x
    return poses


def share(before: list[float], was: float, now: float, after: float, usual: float = 1e-3) -> float:
    """Of a keyframe's correction, where the frames before it are `before` and the frame after it is `after`."""
    poses = along(*before, now, after)
    return shared(poses, STAMPS, np.array([0.8, 0.9, 0, 0]), along(was)[0], along(now)[0], usual)


def test_unevenness_by_hand() -> None:
    values = np.array([[0.0], [1.0], [4.0], [4.0]])
    np.testing.assert_allclose(unevenness(values, np.arange(4.0)), [[-1.0], [1.5]])
    np.testing.assert_allclose(unevenness(values, np.array([0.0, 1.0, 4.0, 4.0])), [[0.0], [0.0]])
    np.testing.assert_allclose(unevenness(values[:3], np.zeros(3)), [[-1.0]])


def test_a_turn_moves_the_point_before_the_camera() -> None:
    turned = np.eye(4)
    turned[:3, :3] = [[np.cos(0.1), 0, np.sin(0.1)], [0, 1, 0], [-np.sin(0.1), 0, np.cos(0.1)]]
    np.testing.assert_allclose(places(turned[None])[0], [0, 0, 0, 2 * np.sin(0.1), 0, 2 * np.cos(0.1)])


def test_what_is_usual_is_the_median_and_at_least_half_a_millimetre() -> None:
    assert usual_unevenness(along(0, 0.1, 0.2, 0.3), STAMPS) == 5e-4
    # 0.1 m off, and each neighbour by half of that; centre and point before the camera are off alike
    assert usual_unevenness(along(0, 0.1, 0.3, 0.3, 0.4), np.arange(5) / 30) == pytest.approx(0.05 * 2**0.5)
    assert usual_unevenness(along(0, 0.1), STAMPS[:2]) == 5e-4


def test_an_error_that_grew_slowly_is_shared() -> None:
    """The camera moves by 10 mm from frame to frame, and is 4, 4.5 and 5 cm off when it becomes a keyframe."""
    assert share([0.0 - 0.04, 0.01 - 0.045], 0.02 - 0.05, 0.02, 0.03) > 0.99


def test_an_error_of_the_keyframe_alone_is_not_shared() -> None:
    assert share([0.0, 0.01], 0.02 - 0.05, 0.02, 0.03) < 0.05
    assert share([0.0 - 0.02, 0.01 - 0.0225], 0.02 - 0.05, 0.02, 0.03) == pytest.approx(0.5, abs=0.05)  # half of it


def test_where_the_motion_is_as_uneven_as_the_correction_all_of_it_is_shared() -> None:
    assert share([0.0, 0.01], 0.02 - 0.005, 0.02, 0.03, usual=5e-3) > 0.98
