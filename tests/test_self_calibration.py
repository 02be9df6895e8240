"""Self-calibration from images: a camera that is stated wrongly is found, one that is right stays, and a still camera tells nothing."""

from dataclasses import replace

import numpy as np
import pytest

from idfslam.adjustment.camera_model import NAMES
from idfslam.adjustment.landmark_tracks import View
from idfslam.adjustment.self_calibration import Estimate, Footage, of_size, self_calibrate, with_scale
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.geometry.camera import Camera

FRAMES = range(0, 200, 20)
ASKED = ("focal", "cx", "cy")


@pytest.fixture(scope="module")
def footage() -> Footage:
    """Ten keyframes of a generated room with the noise of a Kinect, at true poses."""
    room = SyntheticRoom(seed=0, frames=600, width=320, height=240, noise=True)
    start = np.linalg.inv(room.ground_truth[0])
    return Footage([View.of(room[i]) for i in FRAMES], np.array([start @ room.ground_truth[i] for i in FRAMES]))


def stated(footage: Footage, *, focal: float = 1.0, shift: float = 0.0) -> Footage:
    """The same with another stated camera."""
    c = footage.views[0].camera
    camera = Camera(c.width, c.height, c.fx * focal, c.fy * focal, c.cx + shift, c.cy)
    return Footage([replace(view, camera=camera) for view in footage.views], footage.poses)


def of(estimate: Estimate, name: str) -> tuple[float, float]:
    return float(estimate.model.values[NAMES.index(name)]), float(estimate.sigmas[NAMES.index(name)])


def test_a_camera_that_is_right_stays(footage: Footage) -> None:
    estimate = self_calibrate([footage])
    assert estimate is not None
    assert estimate.landmarks > 300
    for name in ASKED:
        value, sigma = of(estimate, name)
        assert abs(value) < 3 * sigma
        assert sigma < 0.002


def test_a_wrong_camera_is_found_from_poses_that_fit_it(footage: Footage) -> None:
    """The focal length is 4 % too long, the centre is 5 px off."""
    estimate = self_calibrate([stated(footage, focal=1.04, shift=5.0)])
    assert estimate is not None
    for name, true, within in (("focal", 1 / 1.04 - 1, 0.003), ("cx", -5 / 320, 0.0015), ("cy", 0.0, 0.0015)):
        value, sigma = of(estimate, name)
        assert value == pytest.approx(true, abs=within)
        assert abs(value - true) < 3 * sigma


def test_an_estimate_may_be_gone_on_from(footage: Footage) -> None:
    wrong = [stated(footage, focal=1.04, shift=5.0)]
    once, twice = self_calibrate(wrong, rounds=1), self_calibrate(wrong, rounds=2)
    again = self_calibrate(wrong, rounds=1, start=once)
    assert once is not None and twice is not None and again is not None
    assert np.abs(once.model.values - twice.model.values).max() > 0
    np.testing.assert_array_equal(again.model.values, twice.model.values)
    np.testing.assert_array_equal(again.covariance, twice.covariance)


def test_true_poses_tell_the_scale_of_depth(footage: Footage) -> None:
    """Depth is 2 % too long."""
    longer = Footage([replace(view, depth=view.depth * np.float32(1.02)) for view in footage.views], footage.poses)
    estimate = self_calibrate([longer])
    assert estimate is not None
    assert not estimate.determined("depth_scale")
    scaled = with_scale(estimate, [footage.poses])
    assert scaled is not None
    value, sigma = of(scaled, "depth_scale")
    assert value == pytest.approx(1 / 1.02 - 1, abs=0.004)
    assert abs(value - (1 / 1.02 - 1)) < 3 * sigma


def test_two_keyframes_are_too_few(footage: Footage) -> None:
    assert self_calibrate([Footage(footage.views[:2], footage.poses[:2])]) is None


def test_a_camera_that_stands_still_tells_nothing_of_itself(footage: Footage) -> None:
    still = Footage([footage.views[0]] * 4, np.tile(np.eye(4), (4, 1, 1)))
    estimate = self_calibrate([still])
    assert estimate is None or not any(estimate.determined(name) for name in ("focal", "cx", "cy", "k1"))


def test_values_are_of_any_size(footage: Footage) -> None:
    """Deviations of the centre are shares of the width."""
    estimate = self_calibrate([Footage(footage.views[:5], footage.poses[:5])])
    assert estimate is not None
    full = of_size(estimate.model, footage.views[0].camera.resized(640, 480)).camera
    half = full.resized(320, 240)
    assert half.cx == pytest.approx(estimate.model.camera.cx, abs=1e-9)
    assert half.fx == pytest.approx(estimate.model.camera.fx, abs=1e-9)
