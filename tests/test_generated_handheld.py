"""Hand-held recordings with a sensor's faults: each part of an image against one of the ideal twin, taken at the true time of that part."""

from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from idfslam.datasets import generated
from idfslam.datasets.generated.capture_times import DepthClock, kept_shots
from idfslam.datasets.generated.colour_camera import AutomaticColourCamera, developed, radiance
from idfslam.datasets.generated.corridor import SyntheticCorridor
from idfslam.datasets.generated.corridor_walk import Walk
from idfslam.datasets.generated.depth_camera import patches, projector_shadow, with_flying_pixels
from idfslam.datasets.generated.exposure import AutomaticExposure
from idfslam.datasets.generated.faults import FAULTS, Faults
from idfslam.datasets.generated.handheld import HandheldRecording, handheld_corridor, handheld_room
from idfslam.datasets.generated.handheld_motion import ROUND, HandheldMotion
from idfslam.datasets.generated.miscalibration import Miscalibration
from idfslam.datasets.generated.room import tour_at
from idfslam.datasets.generated.sensor_noise import noisy_colour, noisy_depth
from idfslam.datasets.generated.shutter import drawn_readouts, row_times
from idfslam.datasets.opening import open_recording
from idfslam.errors import ConfigError, FrameError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.geometry.sensor_timing import SensorTiming
from idfslam.scenes.corridor import draw_corridor

SIZE = {"width": 160, "height": 120}


@cache
def recording(faults: str = "", seed: int = 0, frames: int = 600) -> HandheldRecording:
    return handheld_room(Faults.named(faults or None), seed, frames, **SIZE)


@cache
def motion(seed: int) -> HandheldMotion:
    """The motion alone: a room takes seconds."""
    return HandheldMotion(lambda t: tour_at(t * 30, seed, (2.7, 2.3)), seed)


@cache
def fastest() -> int:
    """The frame of a burst in which the camera turns fastest."""
    return int(np.argmax(degrees(recording("ideal").ground_truth)))


def same(a: Frame, b: Frame) -> bool:
    images = np.array_equal(a.colour, b.colour) and np.array_equal(a.depth, b.depth)
    return images and (a.timestamp, a.depth_timestamp, a.timing, a.camera) == (b.timestamp, b.depth_timestamp, b.timing, b.camera)


def degrees(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N - 1,) turns from pose to pose."""
    cosine = (np.einsum("nij,nij->n", poses[:-1, :3, :3], poses[1:, :3, :3]) - 1) / 2
    return np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))


# ----- names


def test_faults_by_name() -> None:
    assert Faults.named(None) == Faults(**dict.fromkeys(FAULTS, 1.0))
    assert Faults.named("ideal") == Faults.named("shutter=0") == Faults()
    assert Faults.named("shutter=0.5+time") == Faults(shutter=0.5, time=1)
    assert [str(Faults.named(text)) for text in ("time+shutter=0.5", "drops=2", "ideal")] == ["shutter=0.5+time", "drops=2", "ideal"]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("fog", "the fault is 'fog', expected ideal, or shutter, time"),
        ("shutter+", "the fault is '', expected"),
        ("", "the fault is '', expected"),
        ("ideal+time", "the fault is 'ideal', expected"),
        ("time+time=2", "the fault is 'time=2' once more, expected"),
        ("time=fast", "the fault is 'time=fast', expected"),
        ("time=-1", "the fault is 'time=-1', expected"),
        ("time=11", "the strength of time is 11, expected 0 to 10"),
    ],
)
def test_unknown_faults_are_refused(text: str, found: str) -> None:
    with pytest.raises(ConfigError) as error:
        open_recording(f"synthetic:0:handheld-{text}")
    assert str(error.value).startswith(f"synthetic:0:handheld-{text}: {found}")
    assert "\n" not in str(error.value)


def test_names_of_recordings() -> None:
    kinds = [generated.kind_of(name) for name in ("synthetic:handheld", "synthetic:3:handheld-ideal", "synthetic:3:handheld-time=2+drops")]
    assert kinds == ["synthetic"] * 3
    assert [generated.kind_of(name) for name in ("synthetic:handheldx", "synthetic:kinect:handheld")] == [None] * 2
    opened = open_recording("synthetic:0:handheld-shutter=0.5+time", frames=3)
    assert (opened.name, len(opened), opened.camera.width) == ("synthetic-0-handheld-shutter=0.5+time", 3, 640)
    assert [recording(name).name for name in ("ideal", "")] == ["synthetic-0-handheld-ideal", "synthetic-0-handheld"]


# ----- motion


@pytest.mark.parametrize("seed", range(12))
def test_motion_is_a_shaking_hands(seed: int) -> None:
    poses = motion(seed).pose_at(np.arange(600) / 30)
    assert 1.1 <= np.median(degrees(poses)) <= 1.5
    assert 6 <= degrees(poses).max() <= 8
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert 0.008 < np.median(steps) < 0.014
    assert steps.max() < 0.035


@pytest.mark.parametrize("seed", range(6))
def test_motion_in_a_corridor(seed: int) -> None:
    plan = draw_corridor(seed).plan
    poses = HandheldMotion(Walk(seed, plan).pose_at, seed).pose_at(np.arange(1200) / 30)
    assert 1.0 <= np.median(degrees(poses)) <= 1.5  # straight stretches are calmer than a tour around a room
    assert 6 <= degrees(poses).max() <= 9  # the head turns as well
    assert np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).max() < 0.05


def test_bursts_shake_at_two_to_six_hertz_about_all_axes() -> None:
    bursts = [burst for seed in range(4) for number in range(3) for burst in motion(seed).bursts(number)]
    frequencies = np.array([burst.frequency for burst in bursts])
    assert (frequencies >= 2).all()
    assert (frequencies <= 6).all()
    assert (np.abs([burst.axes[0] for burst in bursts]).mean(0) > 0.3).all()
    assert all(burst.axes @ burst.axes.T == pytest.approx(np.eye(2)) for burst in bursts)
    assert all(2 * ROUND < burst.middle < 3 * ROUND for burst in motion(1).bursts(2))
    assert len({burst.middle for burst in bursts}) == len(bursts)  # no two recordings or rounds are shaken alike


def test_motion_is_smooth_and_its_velocity_its_derivative() -> None:
    t = np.arange(-0.1, 21, 1 / 3000)
    poses = motion(2).pose_at(t)
    np.testing.assert_allclose(motion(2).pose_at(t[7000:7001]), poses[7000:7001], atol=1e-14)  # a pose depends on its time alone
    assert degrees(poses).max() < 8 / 100  # 100 steps in a frame's time: nowhere a jump
    assert np.abs(np.diff(degrees(poses))).max() < 0.01
    at, dt = 4.321, 1e-3
    v, (here, later) = motion(2).velocity_at(at), motion(2).pose_at(np.array([at, at + dt]))
    np.testing.assert_allclose(here[:3, :3].T @ (later[:3, 3] - here[:3, 3]), v[:3] * dt, atol=2e-5)
    assert np.rad2deg(np.linalg.norm(v[3:])) * dt == pytest.approx(degrees(np.stack([here, later]))[0], rel=0.02)


def test_a_longer_recording_begins_with_the_shorter_one() -> None:
    long, short = recording(frames=700), recording(frames=90)
    np.testing.assert_array_equal(long.ground_truth[:90], short.ground_truth)
    np.testing.assert_array_equal(long.depth_timestamps[:90], short.depth_timestamps)
    assert same(long[70], short[70])


# ----- the ideal twin


def test_the_twin_is_an_ideal_camera_with_the_noise_of_a_kinect() -> None:
    twin = recording("ideal")
    frame, exact = twin[200], twin.exact(200)
    assert (frame.timestamp, frame.depth_lag, frame.timing, frame.camera) == (200 / 30, 0.0, SensorTiming(), twin.true_camera)
    rng = np.random.default_rng([0, 200])
    np.testing.assert_array_equal(frame.depth, noisy_depth(exact.depth, exact.normals, twin.true_camera, rng))
    np.testing.assert_array_equal(frame.colour, noisy_colour(exact.colour, 200 / 30, rng))
    assert (twin.true_timing, twin.camera) == (SensorTiming(), twin.true_camera)


@pytest.mark.parametrize("faults", ["", "shutter", "time", "calibration", "light+depth", "shutter=2+time=3"])
def test_faults_leave_motion_and_scene_as_they_are(faults: str) -> None:
    np.testing.assert_array_equal(recording(faults).ground_truth, recording("ideal", frames=700).ground_truth[recording(faults).shots])
    np.testing.assert_array_equal(recording(faults).exact(40).depth, recording("ideal").exact(int(recording(faults).shots[40])).depth)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_strength_zero_is_none(fault: str) -> None:
    none = recording(f"{fault}=0")
    assert all(same(none[i], recording("ideal")[i]) for i in (0, fastest()))


def test_frames_are_the_same_in_any_order() -> None:
    first = [recording()[i] for i in (3, 250, 11)]
    again = handheld_room(Faults.named(None), 0, **SIZE)
    assert all(same(a, again[i]) for a, i in reversed([*zip(first, (3, 250, 11))]))


# ----- shutter


def test_a_row_is_that_of_a_global_shutter_at_its_time() -> None:
    rolling, i = recording("shutter"), fastest()
    readout, depth_readout, delay = rolling.true_timing.readout, rolling.true_timing.depth_readout, rolling.true_timing.depth_delay
    assert readout is not None
    assert depth_readout is not None
    assert delay == 0
    assert 0.02 <= readout <= 0.03
    assert 0.02 <= depth_readout <= 0.03
    scene, camera = rolling._scene, rolling.true_camera
    colour = scene.render(camera, rolling.colour_poses(i)).colour
    depth, normals = scene.render_depth(camera, rolling.depth_poses(i))
    for row in (0, 17, 60, 119):
        share = (row + 0.5) / 120 - 0.5
        at = scene.render(camera, rolling.motion.pose_at(np.array([i / 30 + readout * share]))[0])
        assert (at.colour[row] == colour[row]).all(-1).mean() > 0.95  # the others lie at edges, which the rows beside help to find
        taken = scene.render(camera, rolling.motion.pose_at(np.array([i / 30 + depth_readout * share]))[0])
        np.testing.assert_array_equal(taken.depth[row], depth[row])
        np.testing.assert_array_equal(taken.normals[row], normals[row])
    assert (np.abs(depth - rolling.exact(i).depth) > 0.02).mean() > 0.05  # a fast turn shears the image
    assert rolling[i].timing == SensorTiming(None, None, None)


def test_times_of_rows() -> None:
    assert row_times(2.0, 0.04, 4) == pytest.approx([1.985, 1.995, 2.005, 2.015])  # eighths of 40 ms from the middle
    assert row_times(2.0, 0.0, 4).tolist() == [2.0]
    readouts = np.array([drawn_readouts(seed, 1) for seed in range(20)])
    assert readouts.min() >= 0.02
    assert readouts.max() <= 0.03
    assert readouts.std(0).min() > 0.002
    np.testing.assert_allclose(drawn_readouts(3, 0.5), np.array(drawn_readouts(3, 1)) / 2)


def test_rendering_takes_one_pose_or_one_a_row() -> None:
    rolling = recording("shutter")
    with pytest.raises(ValueError, match="7 poses, expected one, or one for each of 120 rows"):
        rolling._scene.render(rolling.true_camera, rolling.ground_truth[:7])


# ----- time


def test_depth_drifts_against_colour_and_lies_by_a_constant() -> None:
    late = recording("time")
    lag = (late.depth_timestamps - late.timestamps) * 30  # in frames
    assert np.abs(lag).max() <= 0.5
    assert np.ptp(lag) > 0.9
    assert (np.diff(late.depth_timestamps) > 0).all()
    jumps = np.abs(np.diff(lag)) > 0.5  # from late to early: one image of depth is left out
    assert 2 <= jumps.sum() <= 4
    assert np.diff(lag)[~jumps].std() < 1e-9
    delay = late.true_timing.depth_delay
    assert delay is not None
    assert 0.005 <= abs(delay) <= 0.012
    i = fastest()
    frame = late[i]
    assert (frame.timestamp, frame.depth_timestamp, frame.timing) == (i / 30, late.depth_timestamps[i], SensorTiming(None, None, None))
    np.testing.assert_array_equal(late.depth_poses(i), late.motion.pose_at(late.depth_timestamps[i : i + 1] + delay))
    np.testing.assert_array_equal(frame.colour, recording("ideal")[i].colour)
    assert not np.array_equal(frame.depth, recording("ideal")[i].depth)


def test_clock_of_depth_by_hand() -> None:
    # Depth takes 10 images where colour takes 9: at 0, 0.9, 1.8 ... frames. Nearest to 0, 3, 4, 9: 0, 2.7, 3.6, 9
    clock = DepthClock(sweep=10, phase=0, strength=1, delay=0)
    assert clock.stamps(np.array([0, 3, 4, 9])) * 30 == pytest.approx([0, 2.7, 3.6, 9])
    half = DepthClock(sweep=10, phase=0, strength=0.5, delay=0)
    assert half.stamps(np.array([0, 3, 4, 9])) * 30 == pytest.approx([0, 2.85, 3.8, 9])
    delays = np.array([DepthClock.drawn(seed, 1).delay for seed in range(20)])
    assert (delays > 0).any()
    assert (delays < 0).any()


def test_times_that_are_known_are_stated() -> None:
    """The user may state the sensor's times, of which the recording states none; everything else about its camera is its own."""
    camera = {"readout": 0.025, "depth_delay": -0.007}
    assert open_recording("synthetic:0:handheld-time", camera=camera, frames=1)[0].timing == SensorTiming(0.025, None, -0.007)
    assert handheld_room(Faults(), known=SensorTiming(None, 0.02, None), **SIZE).timing == SensorTiming(0.0, 0.02, 0.0)
    with pytest.raises(ConfigError, match="own camera and depth"):
        open_recording("synthetic:0:handheld", camera={"fx": 500.0})
    with pytest.raises(ConfigError, match="own camera and depth"):
        open_recording("synthetic:0:kinect", camera={"readout": 0.025})


# ----- calibration


def test_the_stated_camera_is_not_the_true_one() -> None:
    off = recording("calibration")
    assert off.camera != off.true_camera == recording("ideal").camera
    assert off[5].camera == off.camera
    assert 0.008 <= abs(off.camera.fx / off.true_camera.fx - 1) <= 0.012
    assert abs(off.camera.fy / off.true_camera.fy - 1) <= 0.013
    for stated, true in ((off.camera.cx, off.true_camera.cx), (off.camera.cy, off.true_camera.cy)):
        assert 2 <= abs(stated - true) * 4 <= 4.5  # in pixels of an image 640 wide
    np.testing.assert_array_equal(off[5].colour, recording("ideal")[5].colour)  # images are those of the true camera
    ratio = off[5].depth / np.where(recording("ideal")[5].depth > 0, recording("ideal")[5].depth, np.nan)
    assert 0.004 < abs(np.nanmedian(np.where(ratio > 0.5, ratio, np.nan)) - 1) < 0.018


def test_depth_is_scaled_and_warped_by_hand() -> None:
    # The middle of 3 x 3 pixels is at (0, 0), a corner at 2/3 of either half: its square is 8/9, of which half counts
    off = Miscalibration((0.01, 0.02), (4.0, -2.0), scale=0.01, warp=0.006)
    z = np.full((3, 3), 2.25, np.float32)  # half-way to 4.5 m
    z[0, 1] = 0
    told = off.depth(z)
    assert told[1, 1] == pytest.approx(2.25 * (1.01 - 0.006 * 0.5), rel=1e-6)
    assert told[2, 2] == pytest.approx(2.25 * (1.01 + 0.006 * (4 / 9 - 0.5)), rel=1e-6)
    assert told[0, 1] == 0
    assert off.stated(Camera(320, 240, 300, 300, 160, 120)) == Camera(320, 240, 303, 306, 162, 119)


# ----- light


def test_blur_is_the_mean_of_the_light_of_its_moments() -> None:
    camera, i = recording("light").colour_camera, fastest()
    assert isinstance(camera, AutomaticColourCamera)
    moments, exposure = camera.moments(i), camera.exposure(i)
    assert len(moments) >= 3
    assert moments.mean() == pytest.approx(i / 30)
    assert np.diff(moments) == pytest.approx(exposure.time / len(moments))
    light = np.mean([radiance(camera.scene.render(camera.camera, camera.motion.pose_at(t[None])).colour) for t in moments], axis=0)
    expected = (1 - np.exp(-light * camera.vignette[..., None] * exposure.brightness)) ** (1 / camera.gamma)
    np.testing.assert_allclose(camera.image(i), expected, atol=1e-5)
    noise = np.abs(recording("light")[i].colour - noisy_colour(camera.image(i), i / 30, np.random.default_rng(0), 0.0))
    assert noise.mean() == pytest.approx(0.012 * exposure.gain * np.sqrt(2 / np.pi), rel=0.1)
    sharp = np.abs(np.diff(recording("ideal").exact(i).colour, axis=1)).mean()
    assert np.abs(np.diff(camera.image(i), axis=1)).mean() < 0.9 * sharp


def test_blur_goes_with_a_rolling_shutter() -> None:
    """Each row of a blurred image of a rolling shutter is blurred about its own time."""
    both = recording("shutter+light")
    camera, i = both.colour_camera, fastest()
    assert isinstance(camera, AutomaticColourCamera)
    assert both.true_timing == recording("shutter").true_timing
    still = camera.moments(i)[0]
    np.testing.assert_array_equal(camera.poses(still), both.motion.pose_at(row_times(still, both.true_timing.readout or 0, 120)))


def test_film_and_radiance_invert_each_other() -> None:
    # The film of scenes: sqrt(1 - exp(-0.5)) = 0.6273
    assert radiance(np.full((1, 1, 3), 0.6273, np.float32)) == pytest.approx(0.5, abs=1e-3)
    light = np.linspace(0, 6, 30, dtype=np.float32).reshape(1, 10, 3)
    np.testing.assert_allclose(radiance(developed(light, 2.0)), light, rtol=2e-3, atol=1e-6)
    assert developed(np.ones((1, 1, 3), np.float32), 1.0) == pytest.approx(1 - np.exp(-1), abs=1e-6)


def test_vignetting_darkens_the_corners() -> None:
    camera = recording("light").colour_camera
    assert isinstance(camera, AutomaticColourCamera)
    assert camera.vignette[59:61, 79:81] == pytest.approx(1, abs=1e-3)
    assert 0.25 <= 1 - camera.vignette[0, 0] <= 0.45
    assert camera.vignette[0, 0] == pytest.approx(camera.vignette[-1, -1])


def test_exposure_follows_the_view_with_a_lag() -> None:
    """A view of the target's brightness, then from image 100 on one of a quarter of it."""
    automatic = AutomaticExposure(lambda shot: 0.42 if shot < 100 else 0.105, 30.0, seed=0, strength=1)
    before, during, after = (automatic.of(shot) for shot in (100, 106, 160))
    assert before.brightness == pytest.approx(1)
    assert 0.009 <= before.time <= 0.014
    assert before.gain == 1
    assert 1.2 < during.brightness < 3
    assert after.brightness == pytest.approx(4)
    assert after.time == 0.015  # longer in dark views; the gain does the rest
    assert after.gain == pytest.approx(4 * before.time / 0.015)
    bright = AutomaticExposure(lambda shot: 4.2, 30.0, seed=0, strength=1).of(0)
    assert (bright.time, bright.gain) == (0.004, 1)
    half = AutomaticExposure(lambda shot: 0.105, 30.0, seed=0, strength=0.5).of(0)
    assert half.brightness == pytest.approx(2)
    assert half.time == 0.0075


def test_exposures_of_a_recording() -> None:
    camera = recording("light").colour_camera
    assert isinstance(camera, AutomaticColourCamera)
    exposures = [camera.exposure(shot) for shot in range(0, 600, 20)]
    times = np.array([exposure.time for exposure in exposures])
    assert times.min() >= 0.004
    assert times.max() <= 0.015
    assert np.ptp(times) > 0.002
    again = handheld_room(Faults(light=1), 0, **SIZE).colour_camera
    assert isinstance(again, AutomaticColourCamera)
    assert again.exposure(400) == camera.exposure(400)  # whatever was asked for before


# ----- holes and flying pixels


def test_shadow_of_the_projector_by_hand() -> None:
    # 43.5 px m: a disparity of 43.5 px at 1 m and of 21.75 at 2 m: the shadow beside the nearer half is 21.75 px wide, less one
    depth = np.full((2, 100), 2.0, np.float32)
    depth[:, 60:] = 1.0
    dark = projector_shadow(depth, 1.0)
    assert np.flatnonzero(dark[0]).tolist() == list(range(40, 60))
    assert np.flatnonzero(projector_shadow(depth, 0.5)[1]).tolist() == list(range(51, 60))
    assert not projector_shadow(depth[:, ::-1], 1.0).any()  # on the other side none
    assert not projector_shadow(depth, 0.0).any()


def test_flying_pixels_lie_between_the_surfaces_of_an_edge() -> None:
    depth = np.full((100, 40), 1.0, np.float32)
    depth[:, 20:] = 2.0
    mixed = with_flying_pixels(depth, 1.0, np.random.default_rng(0))
    np.testing.assert_array_equal(mixed[:, :19], 1.0)
    np.testing.assert_array_equal(mixed[:, 21:], 2.0)
    flying = mixed[:, 19:21][mixed[:, 19:21] != depth[:, 19:21]]
    assert 0.4 < flying.size / 200 < 0.6
    assert flying.min() > 1
    assert flying.max() < 2
    assert flying.std() > 0.2


def test_holes_are_larger_and_readings_fly() -> None:
    faulty, twin = recording("depth"), recording("ideal")
    more, flying = [], []
    for i in range(0, 600, 60):
        exact, told = faulty.exact_depth(i), faulty[i].depth
        more.append((told == 0).mean() - (twin[i].depth == 0).mean())
        near, far = cv2.erode(exact, np.ones((5, 5))), cv2.dilate(exact, np.ones((5, 5)))
        flying.append(((told > near + 0.1) & (told < far - 0.1)).sum() / (far > near + 0.2).sum())
        np.testing.assert_array_equal(faulty[i].colour, twin[i].colour)
    assert 0.03 < np.mean(more) < 0.2
    assert 0.03 < np.mean(flying) < 0.3


def test_patches_are_evenly_spread_numbers() -> None:
    drawn = patches((480, 640), 640, np.random.default_rng(0))
    assert np.quantile(drawn, [0.1, 0.5, 0.9]) == pytest.approx([0.1, 0.5, 0.9], abs=0.03)
    assert np.abs(np.diff(drawn, axis=1)).mean() < 0.05


# ----- drops


def test_missing_frames_are_told_by_their_stamps() -> None:
    gaps = np.diff(recording("drops").shots) - 1
    assert len(recording("drops")) == 600
    assert set(gaps) == {0, 1, 2, 3, 4}
    assert 0.02 < gaps.sum() / recording("drops").shots[-1] < 0.08
    np.testing.assert_allclose(recording("drops").timestamps, recording("drops").shots / 30)
    i = int(np.argmax(gaps)) + 1
    frame, twin = recording("drops")[i], recording("ideal", frames=700)[int(recording("drops").shots[i])]
    assert np.array_equal(frame.colour, twin.colour)
    assert np.array_equal(frame.depth, twin.depth)
    assert frame.timestamp == twin.timestamp
    np.testing.assert_array_equal(kept_shots(3, 1, 1000)[:200], kept_shots(3, 1, 200))
    assert np.diff(kept_shots(3, 2, 1000)).sum() > np.diff(kept_shots(3, 1, 1000)).sum()


def test_frames_outside_are_refused() -> None:
    with pytest.raises(FrameError, match="frame 600 does not exist"):
        recording()[600]
    with pytest.raises(ConfigError, match="handheld room -1"):
        handheld_room(Faults(), -1)
    with pytest.raises(ConfigError, match="handheld corridor 0, 0 laps"):
        handheld_corridor(Faults(), laps=0)


# ----- the corridor


def test_corridor_by_name() -> None:
    names = ("corridor:handheld", "corridor:3:handheld-ideal:5laps", "corridor:handheld-time=0.5:1lap", "corridor:3laps:handheld")
    assert [generated.kind_of(name) for name in names] == ["corridor"] * 3 + [None]
    with pytest.raises(ConfigError, match="corridor:0:handheld-fog:2laps: the fault is 'fog'"):
        open_recording("corridor:0:handheld-fog:2laps")
    opened = open_recording("corridor:0:handheld-shutter+time:2laps", start=100, frames=1)
    assert opened.name == "corridor-0-2laps-handheld-shutter+time"
    assert (opened.camera.width, opened.camera.height) == (320, 240)


def test_corridor_has_the_same_faults() -> None:
    faulty, twin = (handheld_corridor(Faults.named(text), 0, width=64, height=48) for text in (None, "ideal"))
    plain = SyntheticCorridor(0, width=64, height=48)
    assert len(faulty) == len(twin) == len(plain)
    i = int(np.argmax(degrees(twin.ground_truth)))
    frame, shot = faulty[i], int(faulty.shots[i])
    np.testing.assert_array_equal(faulty.ground_truth[i], faulty.motion.pose_at(np.array([shot / 30]))[0])
    assert frame.timing == SensorTiming(None, None, None)
    assert same(frame, faulty[i])
    away = np.linalg.norm(twin.ground_truth[:, :3, 3] - plain.ground_truth[:, :3, 3], axis=1)
    assert away.max() < 0.15  # the hand turns the camera about a point 20 cm behind it
    rng = np.random.default_rng([0, i])
    np.testing.assert_array_equal(twin[i].depth, noisy_depth(twin.exact(i).depth, twin.exact(i).normals, twin.true_camera, rng))
