"""The times of a sensor in a calibration: several recordings, what is told of them, and what the camera file gets."""

import json
from pathlib import Path

import numpy as np
import pytest

from helpers.point_problem import CAMERA, values
from idfslam.adjustment.camera_model import NAMES, CameraModel
from idfslam.adjustment.self_calibration import CameraEstimate
from idfslam.adjustment.sensor_times import SensorTime, mean_times, time_findings
from idfslam.alignment.timing_estimation import TimingEstimator
from idfslam.datasets.cameras.camera_files import read_given
from idfslam.datasets.provenance import Provenance
from idfslam.geometry.sensor_timing import UNKNOWN, SensorTiming
from idfslam.runs.calibrated_camera import write_camera

FOUND = {"readout": SensorTime(0.0224, 0.0003), "depth_readout": SensorTime(0.0006, 0.0008), "depth_delay": SensorTime(-0.0104, 0.0004)}


class Read:
    """A recording whose camera was stated."""

    camera, provenance = CAMERA, Provenance("intrinsics.txt")


def test_the_mean_is_weighted_by_information() -> None:
    found = mean_times([{"readout": SensorTime(0.020, 0.001)}, {"readout": SensorTime(0.026, 0.002)}, {}])
    assert list(found) == ["readout"]
    assert found["readout"].value == pytest.approx((0.020 * 4 + 0.026) / 5)
    assert found["readout"].sigma == pytest.approx(1e-3 / 1.25**0.5)


def test_what_is_told() -> None:
    colour, depth, delay = time_findings(FOUND)
    assert colour.found == "22.4 ± 0.3 ms" and "motion bends it" in colour.meaning
    assert depth.found == "0.6 ± 0.8 ms" and "not told from zero" in depth.meaning
    assert delay.found == "-10.4 ± 0.4 ms"
    assert not any(finding.doubt for finding in (colour, depth, delay))


def test_the_file_gets_the_sure_ones(tmp_path: Path) -> None:
    estimate = CameraEstimate(CameraModel(CAMERA, values()), np.zeros((len(NAMES), len(NAMES))), [], 500, 2000, 0.2)
    write_camera(tmp_path / "camera.json", estimate, Read(), FOUND)  # type: ignore[arg-type]
    written = json.loads((tmp_path / "camera.json").read_text())["camera"]
    assert (written["readout"], written["depth_delay"]) == (0.0224, -0.0104) and "depth_readout" not in written
    read = read_given(tmp_path / "camera.json")
    assert (read.readout, read.depth_delay) == (0.0224, -0.0104)


def test_stated_times_are_not_estimated() -> None:
    estimator = TimingEstimator()
    assert not estimator.has_seen_motion
    assert list(estimator.estimates(UNKNOWN)) == ["readout", "depth_readout", "depth_delay"]
    assert estimator.estimates(SensorTiming(0.02, None, 0.0)) == {"depth_readout": (0.0, pytest.approx(0.015))}
