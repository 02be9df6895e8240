"""Read-out times and delay of a sensor: found from frames whose residuals they distort, left at zero where the motion shows nothing."""

import numpy as np
import pytest
import torch

from idfslam.alignment.row_moments import RowMoments
from idfslam.alignment.timing_estimation import MovingFrame, TimingEstimator
from idfslam.geometry.sensor_timing import SensorTiming
from idfslam.sensing.rectification import RowTimes

UNKNOWN = SensorTiming(None, None, None)
ZERO = RowTimes()


def estimated(true: RowTimes, *, used: RowTimes = ZERO, speed: float = 1.0, frames: int = 120) -> TimingEstimator:
    """The estimator after frames at random velocities, aligned with the times `used`."""
    generator, rng, estimator = torch.Generator().manual_seed(1), np.random.default_rng(1), TimingEstimator()
    for _ in range(frames):
        velocity = speed * np.concatenate([rng.normal(0, 0.3, 3), rng.normal(0, 1.0, 3)])
        u, sums = torch.from_numpy(velocity), []
        of_depth = true.depth_delay - used.depth_delay, true.depth_readout - used.depth_readout
        for delay, readout in (of_depth, (0.0, true.readout - used.readout)):
            J = torch.randn(500, 6, generator=generator, dtype=torch.float64)
            rows = torch.rand(500, generator=generator, dtype=torch.float64) - 0.5
            r = -(delay + readout * rows) * (J @ u) + 0.003 * torch.randn(500, generator=generator, dtype=torch.float64)
            sums.append(RowMoments.of(J, torch.ones(500, dtype=torch.float64), r, rows).scaled(1 / 0.003**2))
        frame = MovingFrame(*sums, used, 0.0, velocity, np.zeros(6), np.eye(6) / 100)
        estimator.add(frame, velocity, np.eye(6) / 1000, UNKNOWN)
    return estimator


@pytest.mark.parametrize("used", [RowTimes(), RowTimes(0.01, 0.02, 0.005)])
def test_times_are_found(used: RowTimes) -> None:
    estimator = estimated(RowTimes(0.024, 0.03, -0.009), used=used)
    np.testing.assert_allclose(estimator.timing(UNKNOWN), (0.024, 0.03, -0.009), atol=2e-3)


def test_what_is_stated_wins() -> None:
    estimator = estimated(RowTimes(0.024, 0.03, -0.009))
    assert estimator.timing(SensorTiming(0.02, 0.01, 0.0)) == (0.02, 0.01, 0.0)
    assert estimator.timing(SensorTiming(0.0, None, 0.004))[::2] == (0.0, 0.004)


def test_a_synchronised_sensor_stays_at_zero() -> None:
    assert estimated(RowTimes()).timing(UNKNOWN) == (0.0, 0.0, 0.0)


def test_slow_motion_leaves_the_times_at_zero() -> None:
    assert estimated(RowTimes(0.024, 0.03, -0.009), speed=1e-3).timing(UNKNOWN) == (0.0, 0.0, 0.0)
    assert TimingEstimator().timing(UNKNOWN) == (0.0, 0.0, 0.0)


def test_depth_keeps_its_stamp() -> None:
    assert TimingEstimator().of(UNKNOWN, 0.016) == RowTimes(0.0, 0.0, 0.016)
    assert TimingEstimator().of(SensorTiming(0.02, 0.03, -0.01), 0.016) == RowTimes(0.02, 0.03, pytest.approx(0.006))


def test_the_error_that_is_left() -> None:
    """At first as large as the times that are expected; after many frames, and of stated times, small."""
    assert TimingEstimator().relative_error(UNKNOWN, RowTimes(depth_delay=0.01)) == pytest.approx(0.015 * (1 + 2 / 12) ** 0.5 / 0.01)
    true = RowTimes(0.024, 0.03, -0.009)
    assert estimated(true).relative_error(UNKNOWN, true) < 0.02
    assert TimingEstimator().relative_error(SensorTiming(0.024, 0.03, -0.009), true) == 0.0


def test_a_velocity_that_becomes_known_later_counts() -> None:
    """The sums were taken at a wrong velocity, with the true times: these stay, once the velocity is corrected."""
    rng, estimator, times = np.random.default_rng(3), TimingEstimator(), RowTimes(0.024, 0.03, -0.009)
    generator = torch.Generator().manual_seed(3)
    for _ in range(100):
        velocity = np.concatenate([rng.normal(0, 0.3, 3), rng.normal(0, 1.0, 3)])
        wrong, sums = velocity + rng.normal(0, 0.3, 6), []
        for delay, readout in ((times.depth_delay, times.depth_readout), (0.0, times.readout)):
            J = torch.randn(500, 6, generator=generator, dtype=torch.float64)
            rows = torch.rand(500, generator=generator, dtype=torch.float64) - 0.5
            r = -(delay + readout * rows) * (J @ torch.from_numpy(velocity - wrong))
            sums.append(RowMoments.of(J, torch.ones(500, dtype=torch.float64), r, rows).scaled(1 / 0.003**2))
        estimator.add(MovingFrame(*sums, times, 0.0, wrong, np.zeros(6), np.eye(6) / 100), velocity, np.eye(6) / 1000, UNKNOWN)
    np.testing.assert_allclose(estimator.timing(UNKNOWN), (0.024, 0.03, -0.009), atol=5e-4)


def test_state_of_a_moving_frame() -> None:
    rng = np.random.default_rng(2)
    sums = [RowMoments(rng.normal(size=(3, 6, 6)), rng.normal(size=(2, 6))) for _ in range(2)]
    frame = MovingFrame(*sums, RowTimes(0.02, 0.03, -0.01), 0.004, *rng.normal(size=(2, 6)), np.eye(6))
    again = MovingFrame.of(frame.state())
    assert (again.times, again.lag) == (frame.times, frame.lag)
    for of in ("depth", "images"):
        np.testing.assert_array_equal(getattr(again, of).H, getattr(frame, of).H)
        np.testing.assert_array_equal(getattr(again, of).b, getattr(frame, of).b)
    for name in ("velocity", "of_references", "reference_covariance"):
        np.testing.assert_array_equal(getattr(again, name), getattr(frame, name))


def test_state_and_restore() -> None:
    estimator, again = estimated(RowTimes(0.024, 0.03, -0.009)), TimingEstimator()
    assert again.timing(UNKNOWN) == (0.0, 0.0, 0.0)
    again.restore(estimator.state())
    assert again.timing(UNKNOWN) == estimator.timing(UNKNOWN) != (0.0, 0.0, 0.0)


def test_the_deviation_is_that_of_frames_that_err_together() -> None:
    """Depth seems delayed by 5 ms more or less for ten frames at a time. Errors are as large as is told; formal deviations are not."""
    errors, told = [], []
    for seed in range(12):
        rng, estimator = np.random.default_rng(seed), TimingEstimator()
        for wrong in np.repeat(rng.normal(0, 0.005, 10), 10):
            u = np.concatenate([rng.normal(0, 0.3, 3), rng.normal(0, 1.0, 3)])
            H = np.stack([k * np.eye(6) for k in (1e6, 0.0, 1e5)])
            depth, images = RowMoments(H, np.stack([(wrong - 0.009) * (H[0] @ u), np.zeros(6)])), RowMoments(H, np.zeros((2, 6)))
            frame = MovingFrame(depth, images, ZERO, 0.0, u, np.zeros(6), np.eye(6) / 1e4)
            estimator.add(frame, u, np.eye(6) / 1e4, UNKNOWN)
        value, deviation = estimator.estimates(UNKNOWN)["depth_delay"]
        errors.append(value + 0.009)
        told.append(deviation)
    off = np.array(errors) / told
    assert 0.5 < np.sqrt((off**2).mean()) < 2
    assert estimator._estimate((None, None, None))[1][2] < 0.2 * told[-1]


def test_each_frame_counts_at_once() -> None:
    estimator, H, u = TimingEstimator(), np.stack([k * np.eye(6) for k in (1e6, 0.0, 1e5)]), np.array([0, 0, 0, 1.0, 0, 0])
    sums = RowMoments(H, np.zeros((2, 6)))
    assert estimator.estimates(UNKNOWN)["readout"] == (0.0, 0.015)
    estimator.add(MovingFrame(sums, sums, ZERO, 0.0, u, np.zeros(6), np.eye(6) / 100), u, np.eye(6) / 1000, UNKNOWN)
    assert estimator.estimates(UNKNOWN)["readout"] == (0.0, pytest.approx((1e5 + 0.015**-2) ** -0.5))
