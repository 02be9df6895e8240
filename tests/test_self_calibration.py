"""Self-calibration from images: a camera that is stated wrongly is found, one that is right stays, and a still camera tells nothing."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from idfslam.adjustment import self_calibration
from idfslam.adjustment.camera_model import NAMES
from idfslam.adjustment.landmark_tracks import KeyframeView
from idfslam.adjustment.row_motion import KeyframeMotion
from idfslam.adjustment.self_calibration import CameraEstimate, PosedViews, of_size, self_calibrate, with_scale
from idfslam.datasets.generated.faults import Faults
from idfslam.datasets.generated.handheld import handheld_room
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.geometry.camera import Camera
from idfslam.sensing.rectification import Rectification, RowTimes, rectified
from idfslam.slam.keyframe_adjustment.keyframe_motion import motion_around

FRAMES = range(0, 200, 20)
ASKED = ("focal", "cx", "cy")
STILL = KeyframeMotion(RowTimes(), np.zeros(6), np.eye(6), np.zeros(6), None)


@pytest.fixture(scope="module")
def footage() -> PosedViews:
    """Ten keyframes of a generated room with the noise of a Kinect, at true poses."""
    room = SyntheticRoom(seed=0, frames=600, width=320, height=240, noise=True)
    start = np.linalg.inv(room.ground_truth[0])
    return PosedViews(
        [KeyframeView.of(room[i]) for i in FRAMES], np.array([start @ room.ground_truth[i] for i in FRAMES]), [STILL] * len(FRAMES)
    )


def stated(footage: PosedViews, *, focal: float = 1.0, shift: float = 0.0) -> PosedViews:
    """The same with another stated camera."""
    c = footage.views[0].camera
    camera = Camera(c.width, c.height, c.fx * focal, c.fy * focal, c.cx + shift, c.cy)
    return replace(footage, views=[replace(view, camera=camera) for view in footage.views])


def first_of(footage: PosedViews, count: int) -> PosedViews:
    return PosedViews(footage.views[:count], footage.poses[:count], footage.motions[:count])


def of(estimate: CameraEstimate, name: str) -> tuple[float, float]:
    return float(estimate.model.values[NAMES.index(name)]), float(estimate.sigmas[NAMES.index(name)])


def test_a_camera_that_is_right_stays(footage: PosedViews) -> None:
    estimate = self_calibrate([footage])
    assert estimate is not None
    assert estimate.landmarks > 300
    for name in ASKED:
        value, sigma = of(estimate, name)
        assert abs(value) < 3 * sigma
        assert sigma < 0.002


def test_no_camera_where_none_explains_the_images(footage: PosedViews, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(self_calibration, "EXPLAINED", 0.05)
    assert self_calibrate([footage], rounds=1, explained=True) is None


def test_a_wrong_camera_is_found_from_poses_that_fit_it(footage: PosedViews) -> None:
    """The focal length is 4 % too long, the centre is 5 px off."""
    estimate = self_calibrate([stated(footage, focal=1.04, shift=5.0)])
    assert estimate is not None
    for name, true, within in (("focal", 1 / 1.04 - 1, 0.003), ("cx", -5 / 320, 0.0015), ("cy", 0.0, 0.0015)):
        value, sigma = of(estimate, name)
        assert value == pytest.approx(true, abs=within)
        assert abs(value - true) < 3 * sigma


def test_keyframes_that_contradict_the_others_make_it_less_sure(footage: PosedViews) -> None:
    """The images of the last two of ten keyframes are 1 % larger, as through another lens."""
    c = footage.views[0].camera
    M = np.array([[1.01, 0, -0.01 * c.cx], [0, 1.01, -0.01 * c.cy]])
    larger = [replace(v, grey=cv2.warpAffine(v.grey, M, (c.width, c.height), borderMode=cv2.BORDER_REPLICATE)) for v in footage.views[-2:]]
    same, other = self_calibrate([footage], rounds=1), self_calibrate([replace(footage, views=[*footage.views[:-2], *larger])], rounds=1)
    assert same is not None and other is not None
    value, sigma = of(other, "focal")
    assert sigma > 2 * of(same, "focal")[1]
    assert abs(value) < 4 * sigma


def test_an_estimate_may_be_gone_on_from(footage: PosedViews) -> None:
    wrong = [stated(footage, focal=1.04, shift=5.0)]
    once, twice = self_calibrate(wrong, rounds=1), self_calibrate(wrong, rounds=2)
    again = self_calibrate(wrong, rounds=1, start=once)
    assert once is not None and twice is not None and again is not None
    assert np.abs(once.model.values - twice.model.values).max() > 0
    np.testing.assert_array_equal(again.model.values, twice.model.values)
    np.testing.assert_array_equal(again.covariance, twice.covariance)


def test_true_poses_tell_the_scale_of_depth(footage: PosedViews) -> None:
    """Depth is 2 % too long."""
    longer = replace(footage, views=[replace(view, depth=view.depth * np.float32(1.02)) for view in footage.views])
    estimate = self_calibrate([longer])
    assert estimate is not None
    assert of(estimate, "depth_scale")[1] == 0
    scaled = with_scale(estimate, [footage.poses])
    assert scaled is not None
    value, sigma = of(scaled, "depth_scale")
    assert value == pytest.approx(1 / 1.02 - 1, abs=0.004)
    assert abs(value - (1 / 1.02 - 1)) < 3 * sigma


def test_two_keyframes_are_too_few(footage: PosedViews) -> None:
    assert self_calibrate([first_of(footage, 2)]) is None


def test_a_camera_that_stands_still_tells_nothing_of_itself(footage: PosedViews) -> None:
    still = PosedViews([footage.views[0]] * 4, np.tile(np.eye(4), (4, 1, 1)), [STILL] * 4)
    estimate = self_calibrate([still])
    assert estimate is None or not any(of(estimate, name)[1] > 0 for name in ("focal", "cx", "cy", "k1"))


def test_values_are_of_any_size(footage: PosedViews) -> None:
    """Deviations of the centre are shares of the width."""
    estimate = self_calibrate([first_of(footage, 5)])
    assert estimate is not None
    full = of_size(estimate.model, footage.views[0].camera.resized(640, 480)).camera
    half = full.resized(320, 240)
    assert half.cx == pytest.approx(estimate.model.camera.cx, abs=1e-9)
    assert half.fx == pytest.approx(estimate.model.camera.fx, abs=1e-9)


@pytest.fixture(scope="module")
def shaken() -> PosedViews:
    """Ten keyframes of a shaken camera with rolling shutters, at true poses, rectified with velocities that are off."""
    room = handheld_room(Faults.named("shutter=1.5"), 1, 150, 320, 240)
    rng, start, timing = np.random.default_rng(0), np.linalg.inv(room.ground_truth[0]), room.true_timing
    times = RowTimes(timing.readout or 0.0, timing.depth_readout or 0.0, 0.0)
    views, motions, chosen = list[KeyframeView](), list[KeyframeMotion](), range(5, 125, 12)
    for i in chosen:
        given = Rectification(times, room.velocity(i) + rng.standard_normal(6) * ([0.05] * 3 + [0.1] * 3))
        views.append(KeyframeView.of(rectified(room[i], given)))
        near = slice(i - 5, i + 6)
        found = motion_around(room.timestamps[i], room.timestamps[near], room.ground_truth[near], times)
        assert found is not None
        motions.append(replace(found, rectification=given))
    return PosedViews(views, start @ room.ground_truth[chosen], motions)


def test_a_right_camera_with_rolling_shutters_stays(shaken: PosedViews) -> None:
    """What an unknown velocity bends is not the lens's."""
    known, blind = self_calibrate([shaken], rounds=1), self_calibrate([replace(shaken, motions=[STILL] * 10)], rounds=1)
    assert known is not None and blind is not None
    assert known.noise == pytest.approx(0.136, abs=0.03)
    for name in ASKED:
        value, sigma = of(known, name)
        assert abs(value) < min(3 * sigma, 0.004)
    assert blind.noise > 0.25
    assert abs(of(blind, "focal")[0]) > 0.008
    assert abs(of(blind, "cy")[0]) > 0.008  # 2.6 px


def test_times_of_the_sensor_that_are_not_exact_do_not_pass_for_a_lens(shaken: PosedViews) -> None:
    """Read-out times that are 7 ms too short, and depth that is 2 ms early."""
    wrong = [replace(m, times=RowTimes(m.times.readout - 0.007, m.times.depth_readout - 0.007, 0.002)) for m in shaken.motions]
    late = replace(shaken, motions=wrong)
    known, exact, inexact = (
        self_calibrate([footage], rounds=1) for footage in (shaken, late, replace(late, time_sigmas=np.full(3, 0.003)))
    )
    assert known is not None and exact is not None and inexact is not None
    assert inexact.noise == pytest.approx(known.noise, abs=0.002) and exact.noise > known.noise + 0.004
    for name in ASKED:
        assert of(inexact, name)[0] == pytest.approx(of(known, name)[0], abs=5e-4)
    assert of(exact, "focal")[0] > 0.006  # 0.25 %, as known and inexact
    assert of(exact, "focal")[1] > 2 * of(inexact, "focal")[1]


def test_deviations_are_drawn_to_those_of_their_kind() -> None:
    """By the jackknife a value errs by 1 and 3 times its own deviation: by 5 in the mean of the squares, so by 3 and 7 of them together."""
    own = np.where(np.isin(NAMES, ("focal", "cx")), 0.001, 0.0)
    jackknife = own * np.where(np.array(NAMES) == "cx", 3.0, 1.0)
    moderated = self_calibration._moderated(jackknife, own)
    assert moderated[NAMES.index("focal")] == pytest.approx(0.001 * 3**0.5)
    assert moderated[NAMES.index("cx")] == pytest.approx(0.001 * 7**0.5)
    assert np.count_nonzero(moderated) == 2
