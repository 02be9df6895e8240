"""Read-out times and delay of a sensor: found from frames whose residuals they distort, left at zero where the motion shows nothing."""

import numpy as np
import pytest
import torch

from idfslam.alignment.continuous_motion import ContinuousMotion
from idfslam.alignment.row_moments import RowMoments
from idfslam.alignment.timing_estimation import TimingEstimator
from idfslam.geometry.sensor_timing import SensorTiming
from idfslam.sensing.rectification import RowTimes

EYE = torch.eye(4, dtype=torch.float64)
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
        estimator.add(*sums, used, 0.0, velocity, ContinuousMotion().predict(0.0, EYE))
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


def test_state_and_restore() -> None:
    estimator, again = estimated(RowTimes(0.024, 0.03, -0.009)), TimingEstimator()
    again.restore(estimator.state())
    assert again.timing(UNKNOWN) == estimator.timing(UNKNOWN)
